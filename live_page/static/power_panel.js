// The plant's power and shortfall over time.

import {$, json} from "./dom.js";
import {timeChart} from "./chart.js";
import {appended, empty, hasRoom, joined} from "./history.js";
import {values} from "./panels.js";

export const POWERS = [
  {label: "available", color: "--available", fill: "--available-fill", width: 1},
  {label: "delivered", color: "--delivered", width: 2},
  {label: "dispatch", color: "--dispatch", dash: [7, 4], width: 2},
];
const SHORTFALLS = [
  {label: "all", color: "--control", fill: "--control", width: 0},
  {label: "unavoidable", color: "--unavoidable", fill: "--unavoidable", width: 0},
];

export function powerPanel(plan, time, shown, at, seek) {
  const options = {timezone: plan.timezone, cursorKey: "plant", onPick: x => seek(time.cycleAt(x))};
  const powerChart = timeChart($("power-chart"), POWERS, {...options, height: 240});
  const shortfallChart = timeChart($("shortfall-chart"), SHORTFALLS, {...options, height: 100});
  const names = [...POWERS.map(line => line.label), "unavoidable", "control_caused"];
  let history = {...empty(), ...Object.fromEntries(names.map(name => [name, []]))}, current = {};

  function draw() {
    const {from, to} = shown(at), x = history.cycle.map(time.seconds);
    const range = [from, to, at.cycle].map(time.seconds);
    powerChart.show([x, ...POWERS.map(line => history[line.label])], ...range);
    const all = history.control_caused.map((value, row) => value === null ? null : value + history.unavoidable[row]);
    shortfallChart.show([x, all, history.unavoidable], ...range);
    values($("values"), [
      ...POWERS.map(line => ({...line, value: current[line.label]})),
      {label: "shortfall, unavoidable", value: current.unavoidable},
      {label: "shortfall, control-caused", value: current.control_caused},
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
