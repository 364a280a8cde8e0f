// Time charts on uPlot. Colours are read when drawn, so that the theme can change.

const css = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
export const kw = value => value == null ? "–" : value.toLocaleString("en", {
  minimumFractionDigits: Math.abs(value) < 1000 ? 1 : 0, maximumFractionDigits: Math.abs(value) < 1000 ? 1 : 0,
});

const charts = new Set();

export function redrawCharts() {
  for (const chart of charts) chart.redraw(false);
}

// `lines`: {label, color, width?, dash?, fill?} each, colours as names of CSS variables.
// A `bare` chart is nothing but its lines.
export function timeChart(element, lines, {height, timezone, onPick, cursorKey, bare}) {
  const axis = {stroke: () => css("--quiet"), grid: {stroke: () => css("--grid"), width: 1}, ticks: {show: false}, font: "12px system-ui, sans-serif"};
  let now = null;
  // A line at the moment shown, where the chart goes on behind it.
  const markNow = self => {
    const x = Math.round(self.valToPos(now, "x", true)), {left, top, width, height} = self.bbox;
    if (now === null || x > left + width - 2) return;
    self.ctx.fillStyle = css("--ink");
    self.ctx.fillRect(x, top, devicePixelRatio, height);
  };
  const chart = new uPlot({
    hooks: {draw: [markNow]},
    width: element.clientWidth, height, padding: bare ? [0, 0, 0, 0] : [null, 32, null, null],
    tzDate: seconds => uPlot.tzDate(new Date(seconds * 1e3), timezone),
    legend: {show: false},
    cursor: {show: !bare, points: {size: 6}, drag: {x: false, y: false}, sync: {key: cursorKey}, y: false},
    scales: {y: {range: (self, low, high) => low == null ? [0, 1] : [Math.min(low, 0), high > 0 ? high * 1.06 : low < 0 ? 0 : 1]}},
    axes: bare ? [{show: false}, {show: false}] : [
      {...axis, size: 26, space: 70, values: "{HH}:{mm}:{ss}"},
      {...axis, size: 62, label: "kW", labelSize: 16, labelFont: "12px system-ui, sans-serif", labelGap: 0, space: Math.min(34, height / 5)},
    ],
    series: [{}, ...lines.map(line => ({
      label: line.label,
      stroke: () => css(line.color),
      fill: line.fill && (() => css(line.fill)),
      width: line.width ?? 1.5, dash: line.dash, points: {show: false},
    }))],
  }, [[], ...lines.map(() => [])], element);
  charts.add(chart);
  new ResizeObserver(() => chart.setSize({width: element.clientWidth, height})).observe(element);
  if (onPick) chart.over.addEventListener("click", () => {
    if (chart.cursor.left >= 0) onPick(chart.posToVal(chart.cursor.left, "x"));
  });
  return {
    show(columns, from, to, moment) {
      now = moment;
      chart.batch(() => { chart.setData(columns, true); chart.setScale("x", {min: from, max: to}); });
    },
  };
}
