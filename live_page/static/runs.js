// The list of runs in a folder: sorted by a click on a heading, filtered, and two of them compared.

import {$, json} from "./dom.js";
import {power} from "./chart.js";

const number = (value, digits) => value?.toLocaleString("en", {minimumFractionDigits: digits, maximumFractionDigits: digits}) ?? "–";
const percent = share => share == null ? "–" : `${number(share, share !== 0 && share < 0.1 ? 3 : 2)} %`;
const duration = seconds => seconds < 600 ? `${number(seconds, 0)} s` : seconds < 36000 ? `${number(seconds / 60, 0)} min` : `${number(seconds / 3600, 1)} h`;
/** @type {Intl.DateTimeFormatOptions} */
const WHEN = {day: "numeric", month: "short", hour: "2-digit", minute: "2-digit"};

// Each column: its heading, what it sorts by, and what it shows. Those with `middle` show only in
// wider windows, those with `small` in the narrowest ones too.
const figure = (heading, name, more = {}) => ({heading, by: run => run.figures[name], show: run => percent(run.figures[name]), digits: true, ...more});
const COLUMNS = [
  {heading: "run", by: run => run.name, show: link, words: true},
  {heading: "plant", by: run => run.scenario},
  {heading: "rating", by: run => run.rating_kw, show: run => run.rating_kw === null ? "–" : power(run.rating_kw).join(" "), digits: true, small: true},
  {heading: "inverters", by: run => run.inverters, show: run => number(run.inverters, 0), digits: true, middle: true, small: true},
  figure("missed", "control-caused", {small: true}),
  figure("without help", "without-help", {small: true}),
  figure("denied by the sky", "unavoidable", {middle: true}),
  {heading: "how it ended", by: run => run.state, show: run => text(run.unreadable || run.state, run.state === "over" ? "good" : "late"), words: true},
  {heading: "faults", by: run => run.faults.length, show: faults, words: true, middle: true},
  {heading: "recorded", by: run => run.recorded_ms, show: recorded},
  {heading: "for", by: run => run.simulated_s, show: run => run.simulated_s ? duration(run.simulated_s) : "–", digits: true},
];

let list = {runs: []}, sortedBy = COLUMNS.findIndex(column => column.heading === "recorded"), downwards = true;
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
  $("heading").replaceChildren(document.createElement("th"), ...COLUMNS.map((column, place) => {
    const head = document.createElement("th"), button = document.createElement("button");
    button.textContent = column.heading + (place === sortedBy ? (downwards ? " ↓" : " ↑") : "");
    button.onclick = () => { [downwards, sortedBy] = [place === sortedBy ? !downwards : Boolean(column.digits), place]; draw(); };
    head.className = classOf(column);
    head.append(button);
    return head;
  }));
}
const classOf = column => [column.digits && "n", column.middle && "middle", column.words && "words", column.small && "small"].filter(Boolean).join(" ");

function compareValues(a, b) {
  if (a == null || b == null) return a == null ? (b == null ? 0 : 1) : -1;  // What is unknown comes last.
  const order = typeof a === "number" ? a - b : String(a).localeCompare(String(b));
  return downwards ? -order : order;
}

function draw() {
  drawHeading();
  const words = $("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
  const found = list.runs.filter(run => {
    const all = [run.name, run.state, run.scenario, run.scheme, ...run.faults].join(" ").toLowerCase();
    return words.every(word => all.includes(word));
  });
  found.sort((a, b) => compareValues(COLUMNS[sortedBy].by(a), COLUMNS[sortedBy].by(b)));
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
  for (const column of COLUMNS) {
    const cell = line.insertCell();
    cell.className = classOf(column);
    cell.dataset.heading = column.heading;
    cell.append(column.show ? column.show(run) : column.by(run) ?? "–");
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
  draw();
}

$("filter").oninput = draw;
$("compare").onclick = () => {
  const [a, b] = [...chosen].map(encodeURIComponent);
  location.href = `compare?a=${a}&b=${b}`;
};
refresh();
setInterval(refresh, 5000);
