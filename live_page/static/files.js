// A panel as files: its numbers as CSV, its charts as a PNG.

function save(content, name) {
  const link = Object.assign(document.createElement("a"), {href: URL.createObjectURL(content), download: name});
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

export function csvOf(history, time) {
  const names = Object.keys(history).filter(name => name !== "cycle");
  const rows = history.cycle.map((cycle, row) => [cycle, new Date(time.seconds(cycle) * 1e3).toISOString(), ...names.map(name => history[name][row] ?? "")]);
  return [["cycle", "time", ...names.map(name => `${name} [kW]`)], ...rows].map(row => row.join()).join("\n") + "\n";
}

// The charts below each other, on the colour of their card.
function pictureOf(charts) {
  const canvases = charts.map(chart => chart.canvas), picture = document.createElement("canvas");
  picture.width = Math.max(...canvases.map(canvas => canvas.width));
  picture.height = canvases.reduce((sum, canvas) => sum + canvas.height, 0);
  const context = picture.getContext("2d");
  context.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--card");
  context.fillRect(0, 0, picture.width, picture.height);
  canvases.reduce((y, canvas) => { context.drawImage(canvas, 0, y); return y + canvas.height; }, 0);
  return picture;
}

export function fileButtons(element, name, time, history, charts) {
  const files = {
    CSV: () => save(new Blob([csvOf(history(), time)], {type: "text/csv"}), `${name}.csv`),
    PNG: () => pictureOf(charts).toBlob(picture => save(picture, `${name}.png`)),
  };
  element.append(...Object.entries(files).map(([kind, onclick]) =>
    Object.assign(document.createElement("button"), {textContent: kind, title: `save what is shown as ${kind}`, onclick})));
}
