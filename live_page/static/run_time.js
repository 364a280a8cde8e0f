// The times of a run's cycles, and the cycles that the charts show.

const LEAST_CYCLES = 60, GROWTH = 1.25;
/** @type {[string, number][]} */
const SPANS = [["2 min", 120], ["10 min", 600], ["1 h", 3600], ["all", Infinity]];

export function runTime(plan) {
  const format = options => new Intl.DateTimeFormat("en-GB", {timeZone: plan.timezone, ...options});
  const clock = format({hour: "2-digit", minute: "2-digit", second: "2-digit"});
  const day = format({year: "numeric", month: "short", day: "numeric"});
  const seconds = cycle => plan.start_ms / 1e3 + cycle * plan.cycle_s;
  return {
    seconds,
    cycleAt: at => (at - seconds(0)) / plan.cycle_s,
    timeOf: cycle => clock.format(new Date(seconds(cycle) * 1e3)),
    dayOf: cycle => `${day.format(new Date(seconds(cycle) * 1e3))}, ${plan.timezone}`,
  };
}

// The user chooses how many cycles are shown: those up to the current one, or those zoomed to.
export function timeSpan(element, plan, onChange, zoomed = null) {
  let span = SPANS[1][1];
  const buttons = SPANS.map(([name, length]) => {
    const button = Object.assign(document.createElement("button"), {textContent: name});
    button.onclick = () => { span = length; zoomTo(null); };
    return button;
  });
  const back = Object.assign(document.createElement("button"), {textContent: "zoomed ✕", title: "show the whole span again (double click)"});
  back.onclick = () => zoomTo(null);
  element.append(back, ...buttons);

  function press() {
    back.hidden = !zoomed;
    buttons.forEach((button, number) => button.setAttribute("aria-pressed", String(!zoomed && SPANS[number][1] === span)));
  }
  function zoomTo(cycles) {
    zoomed = cycles;
    press();
    onChange();
  }
  function shown({cycle, cycles}) {
    if (zoomed) return zoomed;
    // It grows with the run: a chart that has hardly begun is not an empty one.
    const whole = span === Infinity ? cycles : span / plan.cycle_s;
    const length = Math.max(Math.min(whole, Math.ceil((cycle + 1) * GROWTH), plan.cycles), Math.min(LEAST_CYCLES, plan.cycles), 2);
    const end = Math.max(cycle, length - 1);
    return {from: Math.max(end - length + 1, 0), to: end};
  }
  press();
  return {shown, zoomTo, zoomed: () => zoomed};
}
