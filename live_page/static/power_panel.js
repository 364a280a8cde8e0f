// The plant's power, how far it is from what was asked for, and its shortfall over time.

import {$, json} from "./dom.js";
import {timeChart} from "./chart.js";
import {appended, empty, hasRoom, joined} from "./history.js";
import {values} from "./panels.js";

export const POWERS = [
  {label: "available", color: "--available", fill: "--available-fill", width: 1},
  {label: "delivered", color: "--delivered", width: 2},
  {label: "dispatch", color: "--dispatch", dash: [7, 4], width: 2},
];
const DEVIATION = {label: "delivered − dispatch", color: "--delivered", fill: "--deviation-fill", width: 1.5};
const SHORTFALLS = [
  {label: "all", color: "--control", fill: "--control", width: 0},
  {label: "unavoidable", color: "--unavoidable", fill: "--unavoidable", width: 0},
];
const difference = (a, b) => a == null || b == null ? null : a - b;

export function powerPanel(time, group, shown, at) {
  let history = empty(), current = {}, row = null;
  const onCursor = next => { if (next !== row) { row = next; describe(); } };
  const powerChart = timeChart($("power-chart"), POWERS, group, {height: 230, onCursor});
  const deviationChart = timeChart($("deviation-chart"), [DEVIATION], group, {height: 120, range: "aroundZero"});
  const shortfallChart = timeChart($("shortfall-chart"), SHORTFALLS, group, {height: 96});

  function draw() {
    const {from, to} = shown(at), x = history.cycle.map(time.seconds);
    const range = [from, to, at.cycle].map(time.seconds);
    const column = name => history[name] ?? x.map(() => null);
    powerChart.show([x, ...POWERS.map(line => column(line.label))], ...range);
    const asked = column("dispatch"), unavoidable = column("unavoidable");
    deviationChart.show([x, column("delivered").map((value, i) => difference(value, asked[i]))], ...range);
    const all = column("control_caused").map((value, i) => value === null ? null : value + unavoidable[i]);
    shortfallChart.show([x, all, unavoidable], ...range);
    describe();
  }

  // Its time, and what is marked there.
  function cursorText(cycle) {
    const {from, to} = shown(at), near = Math.max((to - from) / 150, 0.5);
    const texts = group.marks.filter(mark => Math.abs(mark.cycle - cycle) <= near).map(mark => mark.text);
    return [`values at ${time.timeOf(cycle)}`, ...texts.slice(0, 2)].join(" · ");
  }

  // The values under the cursor, or else those of the cycle shown.
  function describe() {
    const pointed = row !== null && history.cycle[row] !== undefined;
    const value = name => pointed ? history[name][row] : current[name];
    $("cursor-time").textContent = pointed ? cursorText(history.cycle[row]) : "";
    values($("values"), [
      ...POWERS.map(line => ({...line, value: value(line.label)})),
      {...DEVIATION, color: null, value: difference(value("delivered"), value("dispatch"))},
      {label: "shortfall, unavoidable", value: value("unavoidable")},
      {label: "control-caused", value: value("control_caused")},
    ]);
  }

  return {
    async load(part) {
      history = joined(await json(`window?${part}&points=1500`), history, at.cycle);
      draw();
    },
    // Keep the values of the newest cycle.
    note(newer) {
      for (const name in newer) current[name] = newer[name].at(-1);
    },
    // Whether cycles can be added to those that are loaded.
    follows: newer => newer.cycle[0] > (history.cycle.at(-1) ?? -1) && hasRoom(history, newer),
    append(newer) {
      history = appended(history, newer, shown(at).from);
      draw();
    },
  };
}
