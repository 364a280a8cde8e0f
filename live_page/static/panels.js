// The smaller panels: values beside a chart, figures of merit, events, timing of the cycle.

import {kw} from "./chart.js";
import {make} from "./map.js";

const KEPT = 60;  // So many cycles the longest time is kept for.

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

export function timingStrip(svg, note, plan) {
  const recent = new Map();
  const real = plan.cycle_wall_s > 0;
  const seen = {stages: 0, top: 0};
  note.textContent = real
    ? `${(plan.cycle_wall_s * 1e3).toLocaleString("en")} ms: first to last message of each stage; thin: the latest of ${KEPT} cycles shown; upright: when the next stage closes`
    : `lockstep, no deadlines: first to last message of each stage, thin: the latest of ${KEPT} cycles shown`;
  let rows = [];
  const draw = () => {
    const width = svg.clientWidth || 1000, label = Math.min(190, width * 0.28), right = 96, high = 24;
    const longest = rows.map(row => Math.max(...recent.get(row.stage)));
    seen.stages = Math.max(seen.stages, rows.length);
    seen.top = real ? plan.cycle_wall_s * 1e3 : Math.max(seen.top * 0.98, ...longest);
    const x = ms => label + Math.min(Math.max(ms / seen.top, 0), 1.02) * (width - label - right);
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${width} ${seen.stages * high + 4}`);
    svg.style.height = `${seen.stages * high + 4}px`;
    rows.forEach((row, index) => {
      const y = index * high + 2, late = row.deadline_ms !== null && row.last_ms > row.deadline_ms;
      make("text", {x: 0, y: y + 15}, svg).textContent = row.stage;
      make("rect", {class: "lane", x: label, y: y + 2, width: width - label - right, height: high - 6, rx: 3}, svg);
      make("rect", {class: late ? "span late" : "span", x: x(row.first_ms), y: y + 4, width: Math.max(x(row.last_ms) - x(row.first_ms), 3), height: high - 10, rx: 2}, svg);
      make("path", {class: "longest", d: `M${x(longest[index])} ${y + 4}v${high - 10}`}, svg);
      if (row.deadline_ms !== null) make("path", {class: "deadline", d: `M${x(row.deadline_ms)} ${y}v${high - 2}`}, svg);
      make("text", {x: width, y: y + 15, "text-anchor": "end", class: late ? "" : "soft"}, svg).textContent = `${row.last_ms.toFixed(row.last_ms < 100 ? 2 : 0)} ms${late ? " late" : ""}`;
    });
  };
  new ResizeObserver(draw).observe(svg.parentElement);
  return next => {
    rows = next;
    for (const row of rows) recent.set(row.stage, [...recent.get(row.stage) ?? [], row.last_ms].slice(-KEPT));
    draw();
  };
}
