"use strict";

// What stands in the page as data becomes a figure. Paper is narrower than a screen: for printing
// each figure is drawn anew at the width of a page.
(() => {
  const PRINTED_WIDTH_PX = 675;
  const settings = {
    responsive: true,
    displaylogo: false,
    displayModeBar: "hover",
    modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
  };
  const plots = [...document.querySelectorAll(".plot")];

  for (const plot of plots) {
    const { data, layout } = JSON.parse(document.getElementById(`${plot.id}-data`).textContent);
    Plotly.newPlot(plot, data, layout, settings);
  }

  const draw = (layout) => plots.forEach((plot) => Plotly.relayout(plot, layout));
  addEventListener("beforeprint", () => draw({ autosize: false, width: PRINTED_WIDTH_PX }));
  addEventListener("afterprint", () => draw({ autosize: true, width: null }));
})();
