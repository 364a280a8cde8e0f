// The smaller panels: values beside a chart, figures of merit, events.

import {kw} from "./chart.js";

export function values(element, entries) {
  element.replaceChildren(...entries.map(({label, color, dash, value}) => {
    const box = document.createElement("div"), name = document.createElement("span"), number = document.createElement("b");
    if (color) name.append(Object.assign(document.createElement("i"), {className: dash ? "swatch dashed" : "swatch", style: `color: var(${color})`}));
    name.append(label);
    number.innerHTML = `${kw(value)} <small>kW</small>`;
    box.append(name, number);
    return box;
  }));
}

export function figures(list, rows) {
  list.replaceChildren(...rows.map(({title, unit, value}) => {
    const row = document.createElement("div");
    row.append(
      Object.assign(document.createElement("dt"), {textContent: title}),
      Object.assign(document.createElement("dd"), {textContent: `${value} ${unit}`}),
    );
    return row;
  }));
}

export function eventList(list, timeOf, seek) {
  const found = new Map();
  let shownAt = -1;
  function dim(cycle) {
    shownAt = cycle;
    for (const {event, line} of found.values()) line.classList.toggle("later", event.cycle > cycle);
  }
  return {
    dim,
    add(events) {
      for (const event of events) {
        const line = found.get(event.number)?.line ?? document.createElement("li");
        line.className = event.kind;
        line.replaceChildren(
          Object.assign(document.createElement("time"), {textContent: timeOf(event.cycle), title: `cycle ${event.cycle}`}),
          Object.assign(document.createElement("span"), {className: "kind", textContent: event.kind}),
          Object.assign(document.createElement("span"), {textContent: `${event.agent}: ${event.text}${event.count > 1 ? ` (${event.count.toLocaleString("en")}×)` : ""}`}),
        );
        line.onclick = () => seek(event.cycle);
        if (!found.has(event.number)) list.prepend(line);
        found.set(event.number, {event, line});
      }
      while (found.size > 500) {
        const [number, {line}] = found.entries().next().value;
        line.remove();
        found.delete(number);
      }
      dim(shownAt);
    },
  };
}
