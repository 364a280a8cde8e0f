// Time charts on uPlot: one cursor and one zoom for all of them, marks of events, the future dimmed.
// Colours are read when drawn, so that light and dark can change.

const colours = new Map();  // Of light or dark: to ask for one makes the browser style the whole page anew.
function css(name) {
  if (!colours.has(name)) colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  return colours.get(name);
}
export const kw = value => value == null ? "–" : value.toLocaleString("en", {
  minimumFractionDigits: Math.abs(value) < 1000 ? 1 : 0, maximumFractionDigits: Math.abs(value) < 1000 ? 1 : 0, signDisplay: "negative",
});

// A power with the unit that suits its size, as number and unit.
export function power(value) {
  if (value == null) return ["–", "kW"];
  return Math.abs(value) < 10000 ? [kw(value), "kW"] : [kw(value / 1e3), "MW"];
}
function tick(value) {
  const inMegawatts = Math.abs(value) >= 10000, number = inMegawatts ? value / 1e3 : value;
  return value === 0 ? "0" : `${number.toLocaleString("en", {maximumFractionDigits: 3})} ${inMegawatts ? "MW" : "kW"}`;
}

const FONT = "12px system-ui, sans-serif";
const DOUBLE_CLICK_MS = 250;
const charts = new Set();

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  colours.clear();
  for (const chart of charts) chart.redraw(false);
});

// Keeps a chart as wide as its element, and returns what shows `columns` of values in it.
function placed(chart, element, height) {
  charts.add(chart);
  new ResizeObserver(() => chart.setSize({width: element.clientWidth, height})).observe(element);
  return (columns, from, to) => chart.batch(() => { chart.setData(columns, true); chart.setScale("x", {min: from, max: to}); });
}

// What all charts of a page share: the chosen span, marks, and who hears where the cursor is.
// `onPick` gets the time of a click, `onZoom` a span, or null to see all again.
export function chartGroup({timezone, onPick, onZoom}) {
  return {timezone, onPick, onZoom, marks: [], key: "run"};
}

// From zero to beyond what is drawn, on either side.
const fromZero = (self, low, high) => low == null ? [0, 1] : [Math.min(low * 1.06, 0), high > 0 ? high * 1.06 : low < 0 ? 0 : 1];

// `lines`: {label, color, width?, dash?, fill?} each, colours as names of CSS variables.
// `onCursor` gets the row under the cursor, null without one.
export function timeChart(element, lines, group, {height, onCursor = null}) {
  const axis = {stroke: () => css("--quiet"), grid: {stroke: () => css("--grid"), width: 1}, ticks: {show: false}, font: FONT};
  let now = null;
  const chart = new uPlot({
    hooks: {
      draw: [self => { dimFuture(self, now); drawMarks(self, group.marks); }],
      setCursor: [self => onCursor?.(self.cursor.left >= 0 ? self.cursor.idx : null)],
      setSelect: [self => zoom(self, group)],
    },
    width: element.clientWidth, height, padding: [8, 32, null, null],
    tzDate: seconds => uPlot.tzDate(new Date(seconds * 1e3), group.timezone),
    legend: {show: false},
    cursor: {
      points: {size: 6}, y: false, drag: {x: true, y: false, setScale: false},
      sync: {key: group.key, scales: ["x", null], filters: {pub: type => !type.includes("click") && type !== "mousedown" && type !== "mouseup"}},
      bind: {dblclick: () => null},
    },
    scales: {y: {range: fromZero}},
    axes: [
      {...axis, size: 26, space: 76, values: "{HH}:{mm}:{ss}"},
      {...axis, size: 66, values: (self, ticks) => ticks.map(tick), space: Math.min(34, height / 5)},
    ],
    series: [{}, ...lines.map(line => ({
      label: line.label, stroke: () => css(line.color), fill: line.fill && (() => css(line.fill)),
      width: line.width ?? 1.5, dash: line.dash, points: {show: false},
    }))],
  }, [[], ...lines.map(() => [])], element);
  const show = placed(chart, element, height);
  listenToClicks(chart, group);
  return {canvas: chart.ctx.canvas, show: (columns, from, to, moment) => { now = moment; show(columns, from, to); }};
}

// A chart that is nothing but its lines: the whole run in the bar.
export function bareChart(element, lines, height) {
  const chart = new uPlot({
    width: element.clientWidth, height, padding: [0, 0, 0, 0], legend: {show: false}, cursor: {show: false},
    scales: {y: {range: fromZero}}, axes: [{show: false}, {show: false}],
    series: [{}, ...lines.map(line => ({stroke: () => css(line.color), fill: line.fill && (() => css(line.fill)), width: 1, points: {show: false}}))],
  }, [[], ...lines.map(() => [])], element);
  return {show: placed(chart, element, height)};
}

function zoom(chart, group) {
  const {left, width} = chart.select;
  if (width < 4) return;
  group.onZoom({from: chart.posToVal(left, "x"), to: chart.posToVal(left + width, "x")});
  chart.setSelect({left: 0, top: 0, width: 0, height: 0}, false);
}

// A click goes to its moment, unless it is the first half of a double click, which ends the zoom.
function listenToClicks(chart, group) {
  let waiting = null;
  chart.over.addEventListener("click", () => {
    const at = chart.cursor.left >= 0 ? chart.posToVal(chart.cursor.left, "x") : null;
    clearTimeout(waiting);
    waiting = setTimeout(() => at !== null && group.onPick(at), DOUBLE_CLICK_MS);
  });
  chart.over.addEventListener("dblclick", () => { clearTimeout(waiting); group.onZoom(null); });
}

// What comes after the moment shown stands behind a veil, with a line at the moment.
function dimFuture(chart, now) {
  if (now === null) return;
  const {left, top, width, height} = chart.bbox, x = Math.round(chart.valToPos(now, "x", true));
  if (x > left + width - 2) return;
  const from = Math.max(x, left);
  chart.ctx.save();
  chart.ctx.globalAlpha = 0.72;
  chart.ctx.fillStyle = css("--card");
  chart.ctx.fillRect(from, top, left + width - from, height);
  chart.ctx.restore();
  if (x < left) return;
  chart.ctx.fillStyle = css("--ink");
  chart.ctx.fillRect(x, top, devicePixelRatio, height);
}

// `marks`: {cycle, seconds, color, text} each.
function drawMarks(chart, marks) {
  const {ctx, bbox: {left, top, width, height}} = chart, size = 5 * devicePixelRatio;
  for (const {seconds, color} of marks) {
    const x = Math.round(chart.valToPos(seconds, "x", true));
    if (x < left || x > left + width) continue;
    ctx.save();
    ctx.fillStyle = ctx.strokeStyle = css(color);
    ctx.globalAlpha = 0.75;
    ctx.setLineDash([3 * devicePixelRatio, 3 * devicePixelRatio]);
    ctx.beginPath();
    ctx.moveTo(x + 0.5, top);
    ctx.lineTo(x + 0.5, top + height);
    ctx.stroke();
    ctx.beginPath();
    ctx.moveTo(x - size, top - size);
    ctx.lineTo(x + size, top - size);
    ctx.lineTo(x, top + size * 0.6);
    ctx.fill();
    ctx.restore();
  }
}
