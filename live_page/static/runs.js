// The list of runs in a folder, with their figures.

document.documentElement.dataset.theme = localStorage.theme ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
const cell = (row, text, number) => {
  const found = row.insertCell();
  found.textContent = text ?? "–";
  if (number) found.className = "n";
  return found;
};

async function refresh() {
  const list = await (await fetch("runs")).json();
  document.getElementById("about").textContent = list.folder;
  document.getElementById("heading").innerHTML = "<th>run<th>state<th>recorded<th>simulated from<th class=n>for<th class=n>MB";
  for (const figure of list.figures) {
    document.getElementById("heading").append(Object.assign(document.createElement("th"), {textContent: figure.heading, className: "n"}));
  }
  document.getElementById("rows").replaceChildren(...list.runs.map(run => {
    const row = document.createElement("tr");
    const link = Object.assign(document.createElement("a"), {href: `run/${encodeURIComponent(run.name)}/`, textContent: run.name.replaceAll("~", "/")});
    cell(row, "").append(link);
    cell(row, run.state || "unfinished");
    const recorded = new Date(run.recorded_ms), when = {day: "numeric", month: "short", hour: "2-digit", minute: "2-digit"};
    cell(row, recorded.toLocaleString("en-GB", when)).title = recorded.toLocaleString("en-GB");
    cell(row, run.start || null);
    cell(row, run.simulated_s ? `${Math.round(run.simulated_s).toLocaleString("en")} s` : null, true);
    cell(row, run.size_mb.toFixed(1), true);
    run.figures.forEach((value, index) => {
      const digits = list.figures[index].decimals;
      cell(row, value?.toLocaleString("en", {minimumFractionDigits: digits, maximumFractionDigits: digits}), true);
    });
    return row;
  }));
}
refresh();
setInterval(refresh, 5000);
