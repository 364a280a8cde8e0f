// Clouds behind the map, where the sky is synthetic: a coarse field, drawn anew for each cycle shown.

import {$, json} from "./dom.js";
import {make} from "./map.js";

const SMALL_PX = 760, DARKEST = 0.75;

// `place`: where metres east and north are in the map, as [x, y], and how long a metre is.
export function cloudLayer(svg, place) {
  const wanted = $("clouds-shown"), holder = make("foreignObject", {class: "clouds"}, svg);
  const canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
  svg.prepend(holder);
  holder.append(canvas);
  wanted.parentElement.hidden = false;
  wanted.checked = innerWidth > SMALL_PX;
  let cycle = null, isBusy = false;

  function draw({columns, rows, values, west_m, north_m, cell_m}) {
    [canvas.width, canvas.height] = [columns, rows];
    const image = pen.createImageData(columns, rows), size = cell_m * place.scale, [x, y] = place.at([west_m, north_m]);
    values.forEach((lost, i) => image.data.set([128, 138, 152, Math.round(255 * DARKEST * lost / 100)], 4 * i));
    pen.putImageData(image, 0, 0);
    for (const [name, value] of Object.entries({x, y, width: columns * size, height: rows * size})) holder.setAttribute(name, value);
  }

  // One request at a time, for the newest cycle that was shown meanwhile.
  async function show(next) {
    cycle = next;
    holder.style.display = wanted.checked ? "" : "none";
    if (!wanted.checked || isBusy) return;
    isBusy = true;
    try {
      for (let drawn = null; drawn !== cycle;) draw(await json(`clouds?cycle=${drawn = cycle}`));
    } catch { holder.style.display = "none"; }  // The page is no longer served.
    isBusy = false;
  }
  wanted.onchange = () => cycle !== null && show(cycle);
  return show;
}
