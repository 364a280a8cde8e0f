// The list of runs in a folder: sorted by a click on a heading, filtered, and two of them compared.

import {$, json} from "./dom.js";
import {toggleTheme} from "./theme.js";

const number = (value, digits) => value?.toLocaleString("en", {minimumFractionDigits: digits, maximumFractionDigits: digits}) ?? "–";
const WHEN = {day: "numeric", month: "short", hour: "2-digit", minute: "2-digit"};

// Each column: its heading, what it sorts by, and what it shows; those with `wide` only in wide windows.
const COLUMNS = [
  {heading: "run", by: run => run.name, show: link, words: true},
  {heading: "how it ended", by: run => run.state, show: run => text(run.unreadable || run.state, run.state === "over" ? "good" : "late"), words: true},
  {heading: "scheme", by: run => run.scheme},
  {heading: "actuator", by: run => run.actuator},
  {heading: "faults", by: run => run.faults.length, show: faults, words: true},
  {heading: "recorded", by: run => run.recorded_ms, show: recorded},
  {heading: "simulated from", by: run => run.start, wide: true},
  {heading: "for [s]", by: run => run.simulated_s, show: run => run.simulated_s ? number(run.simulated_s, 0) : "–", digits: true},
  {heading: "MB", by: run => run.size_mb, show: run => number(run.size_mb, 1), digits: true, wide: true},
];

let list = {runs: [], figures: []}, columns = COLUMNS, sortedBy = 5, downwards = true;
const chosen = new Set();

function text(content, className = "") {
  return Object.assign(document.createElement("span"), {textContent: content, className});
}
function link(run) {
  return Object.assign(document.createElement("a"), {href: `run/${encodeURIComponent(run.name)}/`, textContent: run.name.replaceAll("~", "/")});
}
function faults(run) {
  if (!run.faults.length) return text("none", "soft");
  const shown = text(run.faults.slice(0, 2).join("\n") + (run.faults.length > 2 ? `\nand ${run.faults.length - 2} more` : ""), "faults");
  shown.title = run.faults.join("\n");
  return shown;
}
function recorded(run) {
  const when = new Date(run.recorded_ms), shown = text(when.toLocaleString("en-GB", WHEN));
  shown.title = when.toLocaleString("en-GB");
  return shown;
}

function drawHeading() {
  $("heading").replaceChildren(document.createElement("th"), ...columns.map((column, place) => {
    const head = document.createElement("th"), button = document.createElement("button");
    button.textContent = column.heading + (place === sortedBy ? (downwards ? " ↓" : " ↑") : "");
    button.onclick = () => { [downwards, sortedBy] = [place === sortedBy ? !downwards : Boolean(column.digits), place]; draw(); };
    head.className = classOf(column);
    head.append(button);
    return head;
  }));
}
const classOf = column => [column.digits && "n", column.wide && "wide", column.words && "words", column.figure && "figure"].filter(Boolean).join(" ");

function compareValues(a, b) {
  if (a == null || b == null) return a == null ? (b == null ? 0 : 1) : -1;  // What is unknown comes last.
  const order = typeof a === "number" ? a - b : String(a).localeCompare(String(b));
  return downwards ? -order : order;
}

function draw() {
  drawHeading();
  const words = $("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
  const found = list.runs.filter(run => {
    const all = [run.name, run.state, run.scenario, run.scheme, run.actuator, ...run.faults].join(" ").toLowerCase();
    return words.every(word => all.includes(word));
  });
  found.sort((a, b) => compareValues(columns[sortedBy].by(a), columns[sortedBy].by(b)));
  $("rows").replaceChildren(...found.map(row));
  $("nothing").hidden = found.length > 0;
  $("compare").disabled = chosen.size !== 2;
  $("compare").textContent = chosen.size === 2 ? "compare the two" : `compare: choose ${2 - chosen.size || "two"}`;
}

function row(run) {
  const line = document.createElement("tr");
  const box = Object.assign(document.createElement("input"), {type: "checkbox", checked: chosen.has(run.name), ariaLabel: `choose ${run.name}`});
  box.onchange = () => {
    if (box.checked) chosen.add(run.name); else chosen.delete(run.name);
    if (chosen.size > 2) chosen.delete(chosen.values().next().value);  // The one chosen first.
    draw();
  };
  line.insertCell().append(box);
  for (const column of columns) {
    const cell = line.insertCell();
    cell.className = classOf(column);
    cell.append(column.show ? column.show(run) : column.by(run) || "–");
  }
  return line;
}

async function refresh() {
  try {
    list = await json("runs");
    $("banner").hidden = true;
  } catch {
    $("banner").textContent = "The list is no longer served: `heliarch view` serves it again.";
    $("banner").hidden = false;
    return;
  }
  $("about").textContent = list.folder;
  columns = [...COLUMNS, ...list.figures.map(({heading, decimals}, place) => (
    {heading, by: run => run.figures[place], show: run => number(run.figures[place], decimals), digits: true, figure: true, wide: place > 2}
  ))];
  draw();
}

$("filter").oninput = draw;
$("theme").onclick = toggleTheme;
$("compare").onclick = () => {
  const [a, b] = [...chosen].map(encodeURIComponent);
  open(`compare?a=${a}&b=${b}`);
};
refresh();
setInterval(refresh, 5000);
