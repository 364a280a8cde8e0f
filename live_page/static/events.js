// What happened up to the cycle shown, the newest first. What comes later shows only when asked for.

const MOST = 500;
const BAD = new Set(["not heard", "cut off", "given up", "gap"]);

export function eventList(list, laterButton, timeOf, seek) {
  const found = new Map();
  let shownAt = -1, shows = false;

  function arrange() {
    let later = 0;
    for (const {event, line} of found.values()) {
      const isLater = event.cycle > shownAt;
      later += isLater;
      line.hidden = isLater && !shows;
      line.classList.toggle("later", isLater);
    }
    laterButton.hidden = !later;
    laterButton.textContent = `${shows ? "hide" : "show"} ${later.toLocaleString("en")} later`;
  }
  laterButton.onclick = () => { shows = !shows; arrange(); };

  function write(line, event) {
    const part = (name, properties) => Object.assign(document.createElement(name), properties);
    const times = event.count > 1 ? ` (${event.count.toLocaleString("en")}×)` : "";
    line.className = `${event.kind.replace(" ", "-")}${BAD.has(event.kind) ? " bad" : ""}`;
    line.replaceChildren(
      part("time", {textContent: timeOf(event.cycle), title: `cycle ${event.cycle}`}),
      part("span", {className: "kind", textContent: event.kind}),
      part("span", {textContent: `${event.agent === event.kind ? "" : `${event.agent}: `}${event.text}${times}`}),
    );
    line.onclick = () => seek(event.cycle);
  }

  return {
    // Those that charts mark: up to the cycle shown.
    marks: () => [...found.values()].map(({event}) => event).filter(event => event.cycle <= shownAt),
    showAt(cycle) { shownAt = cycle; arrange(); },
    add(events) {
      for (const event of events) {
        const line = found.get(event.number)?.line ?? document.createElement("li");
        write(line, event);
        if (!found.has(event.number)) list.prepend(line);
        found.set(event.number, {event, line});
      }
      while (found.size > MOST) {
        const [number, {line}] = found.entries().next().value;
        line.remove();
        found.delete(number);
      }
      arrange();
    },
  };
}
