// The bar below the page: the whole run, and where in it the page stands.

import {$, json} from "./dom.js";
import {bareChart} from "./chart.js";
import {POWERS} from "./power_panel.js";

export function positionBar(plan, time, at, seek) {
  const overview = bareChart($("overview"), POWERS, 38);
  let drawn = -1, dragged = null;
  $("position").addEventListener("input", event => {
    const target = +$("position").value;
    clearTimeout(dragged);
    dragged = setTimeout(() => { dragged = null; seek(target); }, 60);
  });
  const last = () => Math.max(plan.cycles, at.cycles) - 1;
  return {
    show() {
      $("position").max = last();
      if (dragged === null) $("position").value = at.cycle;
      $("position-text").textContent = `cycle ${at.cycle.toLocaleString("en")} of 0–${last().toLocaleString("en")}`;
    },
    async drawOverview() {
      $("position").max = last();
      const isOld = at.cycles - drawn > last() / 200 || (at.over && at.cycles !== drawn);
      if (!isOld) return;
      drawn = at.cycles;
      const whole = await json(`window?from=0&to=${at.cycles}&points=600`);
      overview.show([whole.cycle.map(time.seconds), ...POWERS.map(line => whole[line.name])], time.seconds(0), time.seconds(Math.max(last(), 1)));
    },
  };
}
