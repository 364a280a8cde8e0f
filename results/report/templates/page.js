"use strict";

// What stands in the page as data becomes a figure, in the colours of the reader's screen. Paper is
// white and narrower: for printing each figure is drawn anew.
(() => {
  const PRINTED_PX = { width: 675, height: 400 };
  const LIGHT = { ink: "#222222", grid: "#ebebeb", paper: "#ffffff" };
  const DARK = { ink: "#e4e4e4", grid: "#3a3d42", paper: "rgba(0,0,0,0)" };
  const settings = {
    responsive: true,
    displaylogo: false,
    displayModeBar: "hover",
    modeBarButtons: [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
  };
  const plots = [...document.querySelectorAll(".plot")];
  const dark = matchMedia("(prefers-color-scheme: dark)");

  function draw(colours, size) {
    for (const plot of plots) {
      const text = document.getElementById(`${plot.id}-data`).textContent;
      const { data, layout } = JSON.parse(text.replaceAll(LIGHT.ink, colours.ink));
      const lower = Math.min(layout.height, size.height ?? layout.height);
      Object.assign(layout, size, { height: lower });
      plot.style.height = `${lower}px`;
      Object.assign(layout, { paper_bgcolor: colours.paper, plot_bgcolor: colours.paper });
      for (const [name, axis] of Object.entries(layout)) {
        if (/^[xy]axis/.test(name)) {
          const lines = { gridcolor: colours.grid, zerolinecolor: colours.grid };
          layout[name] = { ...axis, ...lines, linecolor: colours.grid };
        }
      }
      Plotly.react(plot, data, layout, settings);
    }
  }

  const show = () => draw(dark.matches ? DARK : LIGHT, {});
  show();
  dark.addEventListener("change", show);
  addEventListener("beforeprint", () => draw(LIGHT, { autosize: false, ...PRINTED_PX }));
  addEventListener("afterprint", show);
})();
