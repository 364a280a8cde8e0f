// The smaller panels: values beside a chart, figures of merit.

import {power} from "./chart.js";

export function values(element, entries) {
  element.replaceChildren(...entries.map(({label, color, dash, value}) => {
    const box = document.createElement("div"), name = document.createElement("span"), number = document.createElement("b");
    if (color) name.append(Object.assign(document.createElement("i"), {className: dash ? "swatch dashed" : "swatch", style: `color: var(${color})`}));
    name.append(label);
    const [text, unit] = power(value);
    number.append(`${text} `, Object.assign(document.createElement("small"), {textContent: unit}));
    box.append(name, number);
    return box;
  }));
}

// Figures of merit say themselves up to which cycle they go.
export function figures(list, about, {cycle, rows}) {
  about.textContent = `up to cycle ${cycle.toLocaleString("en")}`;
  list.replaceChildren(...rows.map(({title, unit, value}) => {
    const row = document.createElement("div");
    row.append(
      Object.assign(document.createElement("dt"), {textContent: title}),
      Object.assign(document.createElement("dd"), {textContent: `${value} ${unit}`}),
    );
    return row;
  }));
}

