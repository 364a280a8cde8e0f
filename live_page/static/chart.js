// Time charts on uPlot. Colours are read when drawn, so that the theme can change.

export const css = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
export const kw = value => value == null ? "–" : value.toLocaleString("en", {
  minimumFractionDigits: Math.abs(value) < 1000 ? 1 : 0, maximumFractionDigits: Math.abs(value) < 1000 ? 1 : 0,
});

const charts = new Set();

export function redrawCharts() {
  for (const chart of charts) chart.redraw(false);
}

// `lines`: {label, color, width?, dash?, fill?} each, colours as names of CSS variables.
export function timeChart(element, lines, {height, timezone, onPick, cursorKey}) {
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
    width: element.clientWidth, height, padding: [null, 32, null, null],
    tzDate: seconds => uPlot.tzDate(new Date(seconds * 1e3), timezone),
    legend: {show: false},
    cursor: {points: {size: 6}, drag: {x: false, y: false}, sync: {key: cursorKey}, y: false},
    scales: {y: {range: (self, low, high) => low == null ? [0, 1] : [Math.min(low, 0), high > 0 ? high * 1.06 : low < 0 ? 0 : 1]}},
    axes: [
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

// What was: desired, delivered and possible power of the whole run, behind the time bar.
export function drawOverview(canvas, columns, cycles) {
  const scale = devicePixelRatio, width = canvas.width = canvas.clientWidth * scale, height = canvas.height = canvas.clientHeight * scale;
  const paint = canvas.getContext("2d");
  paint.fillStyle = css("--grid");
  paint.fillRect(0, 0, width, height);
  if (!columns.cycle?.length) return;
  const top = Math.max(...columns.possible, ...columns.desired, 1e-9);
  const x = cycle => cycle / Math.max(cycles - 1, 1) * width, y = value => height - value / top * height * 0.92;
  const trace = (values, close) => {
    paint.beginPath();
    let begun = null;
    values.forEach((value, row) => {
      if (value == null) return;
      const at = x(columns.cycle[row]);
      if (begun === null) { begun = at; close ? paint.moveTo(at, height) : paint.moveTo(at, y(value)); }
      paint.lineTo(at, y(value));
      if (close && (values[row + 1] == null)) { paint.lineTo(at, height); begun = null; }
    });
  };
  paint.fillStyle = css("--possible-fill");
  trace(columns.possible, true); paint.fill();
  paint.lineWidth = 1.2 * scale;
  paint.strokeStyle = css("--desired"); trace(columns.desired); paint.stroke();
  paint.strokeStyle = css("--delivered"); trace(columns.delivered); paint.stroke();
}
