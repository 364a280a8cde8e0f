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
    document.getElementById("heading").append(Object.assign(document.createElement("th"), {textContent: figure, className: "n"}));
  }
  document.getElementById("rows").replaceChildren(...list.runs.map(run => {
    const row = document.createElement("tr");
    const link = Object.assign(document.createElement("a"), {href: `run/${encodeURIComponent(run.name)}/`, textContent: run.name.replaceAll("~", "/")});
    cell(row, "").append(link);
    cell(row, run.state || "unfinished");
    cell(row, new Date(run.recorded_ms).toLocaleString("en-GB", {dateStyle: "medium", timeStyle: "short"}));
    cell(row, run.start || null);
    cell(row, run.simulated_s === null ? null : `${Math.round(run.simulated_s).toLocaleString("en")} s`, true);
    cell(row, run.size_mb.toFixed(1), true);
    for (const value of run.figures) cell(row, value?.toLocaleString("en", {maximumFractionDigits: 3}), true);
    return row;
  }));
}
refresh();
setInterval(refresh, 5000);
