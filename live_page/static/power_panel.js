// The plant's power, and how far it is from what was asked for, with help and without.

import {$, json} from "./dom.js";
import {timeChart} from "./chart.js";
import {fileButtons} from "./files.js";
import {appended, empty, hasRoom, joined} from "./history.js";
import {values} from "./panels.js";

export const POWERS = [
  {label: "available", name: "available", color: "--available", fill: "--available-fill", width: 1},
  {label: "without help", name: "without_help", color: "--alone", width: 1},
  {label: "delivered", name: "delivered", color: "--delivered", width: 2},
  {label: "dispatch", name: "dispatch", color: "--dispatch", dash: [7, 4], width: 2},
];
const DEVIATIONS = [
  {label: "denied by the sky", color: "--unavoidable", fill: "--unavoidable", width: 0},
  {label: "without help", color: "--alone", width: 1},
  {label: "delivered − dispatch", color: "--delivered", fill: "--deviation-fill", width: 1.5},
];
const difference = (a, b) => a == null || b == null ? null : a - b;

export function powerPanel(time, group, shown, at) {
  let history = empty(), current = {}, row = null;
  const onCursor = next => { if (next !== row) { row = next; describe(); } };
  const powerChart = timeChart($("power-chart"), POWERS, group, {height: 230, onCursor});
  const deviationChart = timeChart($("deviation-chart"), DEVIATIONS, group, {height: 150});
  fileButtons($("power-files"), "plant-power", time, () => history, [powerChart, deviationChart]);

  function draw() {
    const {from, to} = shown(at), x = history.cycle.map(time.seconds);
    const range = [from, to, at.cycle].map(time.seconds);
    const column = name => history[name] ?? x.map(() => null);
    powerChart.show([x, ...POWERS.map(line => column(line.name))], ...range);
    const asked = column("dispatch"), off = name => column(name).map((value, i) => difference(value, asked[i]));
    const denied = column("unavoidable").map(value => value == null ? null : -value);
    deviationChart.show([x, denied, off("without_help"), off("delivered")], ...range);
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
      ...POWERS.map(line => ({...line, value: value(line.name)})),
      {label: "deviation", value: difference(value("delivered"), value("dispatch"))},
      {label: "denied by the sky", value: value("unavoidable")},
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
