// The smaller panels: values beside a chart, figures of merit.

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

