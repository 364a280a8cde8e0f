// The inverters where they stand: filled by available power, ringed by delivered power, with help.

import {kw} from "./chart.js";

const NS = "http://www.w3.org/2000/svg";
const RAMP = ["#00224e", "#123570", "#3b496c", "#575d6d", "#707173", "#8a8678", "#a59c74", "#c3b369", "#e1cc55", "#fee838"];
const CLUSTERS = ["#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#8c7ae6", "#b0a030"];
const MOST_LINES = 60;

// Cividis: it rises evenly in brightness, also for the colour-blind.
function ramp(share) {
  const at = Math.min(Math.max(share, 0), 1) * (RAMP.length - 1), low = Math.floor(at), rest = at - low;
  const part = (colour, channel) => parseInt(colour.slice(1 + 2 * channel, 3 + 2 * channel), 16);
  const next = RAMP[Math.min(low + 1, RAMP.length - 1)];
  return `rgb(${[0, 1, 2].map(channel => Math.round(part(RAMP[low], channel) * (1 - rest) + part(next, channel) * rest)).join()})`;
}

export function make(name, attributes, parent) {
  const element = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  parent.append(element);
  return element;
}

// How far apart neighbours stand: three in ten are closer. Neighbours are looked for in the cells around, not in
// the whole plant, which would take the square of its inverters.
function typicalDistance(points) {
  const [width, height] = [0, 1].map(axis => Math.max(...points.map(point => point[axis])) - Math.min(...points.map(point => point[axis])));
  const size = Math.max(Math.sqrt(width * height / points.length), Math.max(width, height) / points.length, 1e-9) * 2;
  const cell = point => point.map(value => Math.floor(value / size)), cells = new Map();
  points.forEach((point, number) => {
    const key = cell(point).join();
    cells.set(key, [...cells.get(key) ?? [], number]);
  });
  const nearest = points.map((point, number) => {
    const [x, y] = cell(point), around = [-1, 0, 1].flatMap(dx => [-1, 0, 1].flatMap(dy => cells.get(`${x + dx},${y + dy}`) ?? []));
    return Math.min(...around.map(other => other === number ? Infinity : Math.hypot(point[0] - points[other][0], point[1] - points[other][1])));
  });
  return nearest.sort((a, b) => a - b)[Math.floor(nearest.length * 0.3)];
}

// The shortest lines that join all points (Prim): they show what belongs together without covering it.
function joined(points) {
  const far = points.map(() => Infinity), from = points.map(() => 0), open = new Set(points.keys());
  const lines = [];
  far[0] = 0;
  while (open.size) {
    const next = [...open].reduce((best, i) => far[i] < far[best] ? i : best);
    open.delete(next);
    if (far[next] > 0) lines.push(`M${points[from[next]]}L${points[next]}`);
    for (const i of open) {
      const length = Math.hypot(points[i][0] - points[next][0], points[i][1] - points[next][1]);
      if (length < far[i]) [far[i], from[i]] = [length, next];
    }
  }
  return lines.join("");
}

// Where nobody knows where the inverters stand, a row for each cluster.
function inRows(nodes) {
  const clusters = new Map();
  nodes.forEach(node => node.inverter && clusters.set(node.parent, [...clusters.get(node.parent) ?? [], node]));
  const points = new Map();
  [...clusters.values()].forEach((row, y) => row.forEach((node, x) => points.set(node, [x * 10, -y * 12])));
  return nodes.filter(node => node.inverter).map(node => points.get(node));
}

// Plants of a fleet are drawn nearer to each other than they are: at most a few widths apart.
function together(points, plants) {
  const middle = of => [0, 1].map(axis => of.reduce((sum, point) => sum + point[axis], 0) / of.length);
  const groups = [...new Set(plants)].map(plant => points.filter((_, i) => plants[i] === plant)), middles = groups.map(middle);
  const wide = Math.max(...groups.map((of, g) => Math.max(...of.map(point => Math.hypot(point[0] - middles[g][0], point[1] - middles[g][1])))));
  const apart = Math.min(...middles.flatMap((a, g) => middles.slice(g + 1).map(b => Math.hypot(a[0] - b[0], a[1] - b[1]))));
  const part = Math.min(3 * wide / apart, 1), places = new Map([...new Set(plants)].map((plant, g) => [plant, middles[g]]));
  return points.map((point, i) => point.map((metre, axis) => metre - (1 - part) * places.get(plants[i])[axis]));
}

// `plant` is the one of a fleet that is shown; empty: all are.
export function plantMap(svg, note, legend, plan, select, plant = "") {
  const every = plan.nodes.map((node, number) => ({...node, number})).filter(node => node.inverter);
  const known = plan.positions_m.length === every.length, plants = every.map(node => node.path.split("/")[0]);
  const placed = !known ? inRows(plan.nodes) : plan.plants.length > 1 ? together(plan.positions_m, plants) : plan.positions_m;
  const inverters = every.filter((_, i) => !plant || plants[i] === plant), metres = placed.filter((_, i) => !plant || plants[i] === plant);
  const [xs, ys] = [0, 1].map(axis => metres.map(point => point[axis]));
  const [left, right, low, high] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const width = 720, margin = 52;
  const scale = Math.min((width - 2 * margin) / Math.max(right - left, 1e-9), 470 / Math.max(high - low, 1e-9));
  const height = Math.max((high - low) * scale + 2 * margin, 240) + 16;
  const middle = [(left + right) / 2, (low + high) / 2];
  const placeOf = ([x, y]) => [width / 2 + (x - middle[0]) * scale, (height - 16) / 2 - (y - middle[1]) * scale];
  const at = metres.map(placeOf);
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.replaceChildren();
  const typical = typicalDistance(at);
  const largest = Math.max(...inverters.map(node => node.rating_kw));
  const size = Math.min(Math.max(typical * 0.45, 3), 24);
  const radius = node => size * Math.sqrt(node.rating_kw / largest);

  const head = Math.min(Math.max(size * 0.6, 4), 9);
  const arrow = make("marker", {id: "arrow", viewBox: "0 0 8 8", refX: 7, refY: 4, markerWidth: head, markerHeight: head, markerUnits: "userSpaceOnUse", orient: "auto"}, make("defs", {}, svg));
  make("path", {d: "M0 0L8 4L0 8z"}, arrow);

  const centre = new Map(inverters.map((node, i) => [node.number, at[i]]));
  const members = new Map();
  inverters.forEach((node, i) => {
    for (let parent = node.parent; parent !== null; parent = plan.nodes[parent].parent) {
      if (!members.has(parent)) members.set(parent, []);
      members.get(parent).push(at[i]);
    }
  });
  for (const [number, points] of members) centre.set(number, [0, 1].map(axis => points.reduce((sum, p) => sum + p[axis], 0) / points.length));

  const shapes = new Map();  // What is drawn for each node, by its number.
  const back = make("g", {}, svg), helpLayer = make("g", {}, svg), front = make("g", {}, svg), labels = make("g", {class: "labels"}, svg);
  const parents = new Set(inverters.map(node => node.parent));
  const clusters = [...members.keys()].filter(number => parents.has(number) && number !== 0);
  back.classList.toggle("many", clusters.length > CLUSTERS.length);
  clusters.forEach((number, colour) => {
    const outline = make("g", {class: "cluster"}, back);
    make("path", {d: joined(members.get(number)), stroke: CLUSTERS[colour % CLUSTERS.length], "stroke-width": Math.max(size * (clusters.length > CLUSTERS.length ? 0.4 : 0.7), 3)}, outline);
    outline.addEventListener("click", () => select(number));
    shapes.set(number, outline);
    make("title", {}, outline).textContent = plan.nodes[number].path;
  });
  nameClusters(legend, clusters.map(number => plan.nodes[number].path));

  let latest = null;  // The frame shown.
  const roomy = typical >= 38;
  const drawn = inverters.map((node, i) => {
    const [x, y] = at[i], r = radius(node);
    const group = make("g", {class: "inverter", transform: `translate(${x},${y})`, tabindex: -1}, front);
    const thick = Math.max(r * 0.27, 1.5), around = r - thick / 2;
    make("circle", {class: "chosen", r: r + 3}, group);
    const body = make("circle", {class: "body", r: r - thick - 0.5}, group);
    make("circle", {class: "track", r: around, "stroke-width": thick}, group);
    const ring = make("circle", {class: "ring", r: around, "stroke-width": thick, pathLength: 100, transform: "rotate(-90)"}, group);
    if (roomy) make("text", {x, y: y + r + 13, "font-size": 12.5}, labels).textContent = node.path.split("/").pop();
    const title = make("title", {}, group);
    group.addEventListener("click", () => select(node.number));
    shapes.set(node.number, group);
    group.addEventListener("pointerenter", () => { if (latest) title.textContent = titleOf(node, latest); });
    return {node, group, body, ring, look: ""};
  });
  const stores = plan.nodes.map((node, number) => ({...node, number})).filter(node => node.capacity_kwh).map((node, row) => {
    const group = make("g", {class: "storage", transform: `translate(14,${height - 30 - row * 32})`, tabindex: -1}, front);
    make("rect", {class: "case", width: 46, height: 22, rx: 3}, group);
    const level = make("rect", {class: "level", x: 2, y: 2, height: 18, rx: 2}, group), text = make("text", {x: 52, y: 16, "font-size": 12.5}, group);
    group.addEventListener("click", () => select(node.number));
    shapes.set(node.number, group);
    return {node, group, level, text};
  });
  if (known && (plant || plan.plants.length < 2)) drawScale(svg, width, height, scale);
  note.textContent = known ? "" : "The recording does not say where the inverters stand: a row for each cluster.";

  return {
    place: {at: placeOf, scale},
    select(number) {
      for (const chosen of svg.querySelectorAll(".selected")) chosen.classList.remove("selected");
      for (const chosen of [number, plan.nodes[number].parent]) shapes.get(chosen)?.classList.add("selected");
    },
    show(frame) {
      latest = frame;
      const {mpp, power} = frame.nodes, unread = new Set(frame.unread);
      for (const one of drawn) {
        const {node, group, body, ring} = one;
        const level = unread.has(node.number) ? 2 : frame.agents.level[node.number + 1];
        const available = mpp[node.number], made = power[node.number];
        const share = made === null ? 0 : Math.min(Math.max(made / node.rating_kw, 0), 1);
        const look = [level, available === null ? "none" : ramp(available / node.rating_kw), Math.round(share * 100)].join();
        if (look === one.look) continue;  // Of thousands of inverters a few change.
        one.look = look;
        group.classList.toggle("late", level === 1);
        group.classList.toggle("bad", level === 2);
        body.classList.toggle("missing", available === null);
        body.setAttribute("fill", available === null ? "none" : ramp(available / node.rating_kw));
        ring.setAttribute("stroke-dasharray", `${share * 100} 200`);
      }
      for (const {node, group, level, text} of stores) {
        const stored = frame.nodes.stored[node.number], made = power[node.number], state = frame.agents.level[node.number + 1];
        level.setAttribute("width", 42 * Math.min(Math.max((stored ?? 0) / 100, 0), 1));
        text.textContent = `${node.path} ${stored?.toFixed(0) ?? "–"} %, ${made < 0 ? `takes ${kw(-made)}` : `gives ${kw(made)}`} kW`;
        group.classList.toggle("late", state === 1);
        group.classList.toggle("bad", state === 2);
      }
      for (const number of clusters) {
        const level = frame.agents.level[number + 1];
        shapes.get(number).classList.toggle("late", level === 1);
        shapes.get(number).classList.toggle("bad", level === 2);
      }
      const shown = frame.help.filter(([donor, needy]) => centre.has(donor) && centre.has(needy)).sort((a, b) => b[2] - a[2]).slice(0, MOST_LINES);
      while (helpLayer.childElementCount < shown.length) make("path", {class: "help"}, helpLayer);
      [...helpLayer.children].forEach((line, row) => {
        line.style.display = row < shown.length ? "" : "none";
        if (row >= shown.length) return;
        const [donor, needy, power_kw] = shown[row], [a, b] = [centre.get(donor), centre.get(needy)];
        const dx = b[0] - a[0], dy = b[1] - a[1], length = Math.hypot(dx, dy) || 1;
        const gap = Math.min(size + 2, length / 3), from = [a[0] + dx / length * gap, a[1] + dy / length * gap], to = [b[0] - dx / length * gap, b[1] - dy / length * gap];
        const bend = [(from[0] + to[0]) / 2 - dy * 0.12, (from[1] + to[1]) / 2 + dx * 0.12];
        line.setAttribute("d", `M${from}Q${bend} ${to}`);
        line.setAttribute("stroke-width", Math.min(1.5 + 3 * size * power_kw / largest, 14).toFixed(1));
        line.setAttribute("marker-end", "url(#arrow)");
      });
      return frame.help.length - shown.length;
    },
  };
}

function titleOf(node, {nodes, agents}) {
  const [available, made] = [nodes.mpp, nodes.power].map(powers => powers[node.number]);
  const [bound, impp] = [nodes.bound, nodes.impp].map(powers => powers[node.number]);
  const known = bound === null ? `IMPP ${kw(impp)} kW` : `IMPP at most ${kw(bound)} kW, its limit hides its maximum`;
  return `${node.path}: available ${kw(available)}, delivers ${kw(made)} of ${kw(node.rating_kw)} kW; ${known}; ${agents.text[node.number + 1]}`;
}

// What the colours of the lines mean. Where there are more clusters than colours, only that they join one.
function nameClusters(legend, names) {
  legend.replaceChildren(...(names.length > CLUSTERS.length ? ["cluster"] : names).map((name, colour) => {
    const entry = document.createElement("span"), line = document.createElement("i");
    line.className = "lines";
    line.style.background = CLUSTERS[colour];
    entry.append(line, name);
    return entry;
  }));
}

function drawScale(svg, width, height, scale) {
  const metres = [10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000].filter(step => step * scale < 160).pop() ?? 10;
  const long = metres * scale, y = height - 6;
  make("path", {class: "scale", d: `M${width - 30 - long} ${y - 6}v6h${long}v-6M${width - 12} ${y}v-20m-5 7l5-7l5 7`}, svg);
  make("text", {x: width - 36 - long, y, class: "soft", "text-anchor": "end"}, svg).textContent = metres < 1000 ? `${metres} m` : `${metres / 1000} km`;
}
