// Light or dark: as the system has it, until the user chooses.

import {redrawCharts} from "./chart.js";

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  redrawCharts();
}

const system = matchMedia("(prefers-color-scheme: dark)");
setTheme(localStorage.theme ?? (system.matches ? "dark" : "light"));
system.addEventListener("change", () => localStorage.theme ?? setTheme(system.matches ? "dark" : "light"));

export function toggleTheme() {
  localStorage.theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  setTheme(localStorage.theme);
}
