// One node: its powers and its help over time, and what it is.

import {$, json} from "./dom.js";
import {kw, timeChart} from "./chart.js";
import {fileButtons} from "./files.js";
import {appended, empty, joined} from "./history.js";
import {values} from "./panels.js";

const POWERS = [
  {label: "available", name: "mpp", color: "--available", fill: "--available-fill", width: 1},
  {label: "IMPP", name: "impp", color: "--impp"},
  {label: "IMPP, at most", name: "bound", color: "--impp", dash: [2, 4]},
  {label: "share", name: "share", color: "--dispatch", dash: [7, 4]},
  {label: "setpoint", name: "setpoint", color: "--setpoint", dash: [3, 3], width: 2},
  {label: "delivered", name: "power", color: "--delivered", width: 2},
];
const HELP = {label: "help", name: "help", color: "--help", fill: "--help", width: 1};

// `selected` is the node's number among those of the plan, null before one was chosen.
export function nodePanel(plan, time, group, shown, at) {
  let history = empty(), frame = null, row = null;
  let devices = {};  // What the gateway measured of real inverters.
  const onCursor = next => { if (next !== row) { row = next; showValues(); } };
  const powerChart = timeChart($("node-chart"), POWERS, group, {height: 300, onCursor});
  const helpChart = timeChart($("help-chart"), [HELP], group, {height: 130});
  fileButtons($("node-files"), "node", time, () => history, [powerChart, helpChart]);

  function draw() {
    const {from, to} = shown(at), x = history.cycle.map(time.seconds);
    const range = [from, to, at.cycle].map(time.seconds);
    const column = name => history[name] ?? x.map(() => null);
    const seen = name => name === "impp" ? column(name).map((value, row) => history.bound?.[row] == null ? value : null) : column(name);
    powerChart.show([x, ...POWERS.map(line => seen(line.name))], ...range);
    helpChart.show([x, column("help")], ...range);
    showValues();
  }

  // The values under the cursor, or else those of the cycle shown.
  function showValues() {
    if (!frame || panel.selected === null) return;
    const pointed = row !== null && history.cycle[row] !== undefined;
    const value = name => pointed ? history[name]?.[row] : frame.nodes[name][panel.selected];
    const unused = value("bound") === null ? "bound" : "impp";
    const lines = [...POWERS, {...HELP, fill: undefined}].filter(({name}) => name !== unused);
    values($("node-values"), lines.map(line => ({...line, value: value(line.name)})));
  }

  function describe() {
    const node = plan.nodes[panel.selected], {reads, late, breaks} = devices[node.path] ?? {};
    const kind = node.capacity_kwh ? "storage" : node.inverter ? "inverter" : panel.selected ? "supervisor" : "central controller";
    let text = `${kind}, ${kw(node.rating_kw)} kW`;
    const stored = frame?.nodes.stored[panel.selected];
    if (node.capacity_kwh) text += ` and ${node.capacity_kwh.toLocaleString("en")} kWh, ${stored?.toFixed(1) ?? "–"} % stored`;
    if (node.device) text += `; ${node.device} ${frame?.unread.includes(panel.selected) ? "gives no readings" : "connected"}`;
    if (reads) text += `; reads take ${reads.p50_ms.toFixed(1)} ms (p50), ${reads.p99_ms.toFixed(1)} ms (p99), ${late} late, connection lost ${breaks}×`;
    $("node-about").textContent = text;
  }

  const panel = {
    selected: null,
    select(number) {
      panel.selected = number;
      $("node-title").textContent = plan.nodes[number].path || "central";
      history = empty();
      describe();
      draw();
    },
    async load(part) {
      const number = panel.selected;
      if (number === null) return;
      const loaded = await json(`node?path=${encodeURIComponent(plan.nodes[number].path)}&${part}`);
      if (number !== panel.selected) return;
      history = joined(loaded, history, at.cycle);
      draw();
    },
    show(next, nextDevices) {
      frame = next;
      devices = nextDevices;
      if (panel.selected !== null) describe();
    },
    append() {
      if (panel.selected === null) return;
      const newer = {cycle: [at.cycle]};
      for (const name in frame.nodes) newer[name] = [frame.nodes[name][panel.selected]];
      history = appended(history, newer, shown(at).from);
      draw();
    },
  };
  return panel;
}
