// What happened up to the cycle shown, the newest first. What comes later shows only when asked for.

const BAD = new Set(["absent", "cut off", "given up"]);
// What charts mark, in which colour.
const MARKED = {
  fault: "--warn", restart: "--good", back: "--good", order: "--accent",
  absent: "--bad", "cut off": "--bad", "given up": "--bad", failure: "--bad",
};
const MOST_MARKS = 200;

function textOf({kind, agent, text, count}) {
  const times = count > 1 ? ` (${count.toLocaleString("en")}×)` : "";
  return `${agent === kind ? "" : `${agent}: `}${text}${times}`;
}

export function eventList(list, laterButton, timeOf, seek) {
  let found = [], shownAt = -1, shows = false;

  function arrange() {
    let later = 0;
    for (const {event, line} of found) {
      const isLater = event.cycle > shownAt;
      later += Number(isLater);
      line.hidden = isLater && !shows;
      line.classList.toggle("later", isLater);
    }
    laterButton.hidden = !later;
    laterButton.textContent = `${shows ? "hide" : "show"} ${later.toLocaleString("en")} later`;
  }
  laterButton.onclick = () => { shows = !shows; arrange(); };

  function lineOf(event) {
    const part = (name, properties) => Object.assign(document.createElement(name), properties);
    const line = part("li", {className: `${event.kind.replace(" ", "-")}${BAD.has(event.kind) ? " bad" : ""}`});
    line.append(
      part("time", {textContent: timeOf(event.cycle), title: `cycle ${event.cycle}`}),
      part("span", {className: "kind", textContent: event.kind}),
      part("span", {textContent: textOf(event)}),
    );
    line.onclick = () => seek(event.cycle);
    return line;
  }

  return {
    // Where charts have marks: faults, restarts and orders up to the cycle shown.
    marks: () => found.map(({event}) => event)
      .filter(event => event.cycle <= shownAt && MARKED[event.kind]).slice(-MOST_MARKS)
      .map(event => ({cycle: event.cycle, color: MARKED[event.kind], text: textOf(event)})),
    showAt(cycle) { shownAt = cycle; arrange(); },
    replace(events) {
      found = events.map(event => ({event, line: lineOf(event)}));
      list.replaceChildren(...found.map(({line}) => line).reverse());
      arrange();
    },
  };
}
