"""A browser draws every figure of a report and has nothing to complain about."""

from __future__ import annotations

from pathlib import Path

from browser import browser, needs_browser
from replayed_runs import run_in_memory, write
from synthetic_runs import cloudy_run, without_estimates

from results.report.page import html_page
from results.report.run_report import runs_result, write_run_report
from results.report.tables import figures_tables

pytestmark = needs_browser

CUT = """
  const seen = document.documentElement.clientWidth;
  const cut = [...document.querySelectorAll("table, p, h1, h2, .plot, svg text, .scroll")].filter(
    (e) => e.getBoundingClientRect().right > seen + 1 ||
      (e.className === "scroll" && e.scrollWidth > e.clientWidth + 1));
  return cut.map((e) => e.tagName + " " + e.textContent.slice(0, 40));
"""
"""What reaches beyond the right edge of the page."""

WIDTHS = """
  return [...document.querySelectorAll(".plot")].map((plot) => [
    plot.id.replace(/-plot$/, ""), +plot.querySelector(".main-svg")?.getAttribute("width"),
    !!plot.querySelector(".point, .js-line, .hm, image, [class*=trace]")]);
"""
"""Of each figure: its width, and whether anything is drawn in it."""


def test_a_browser_draws_every_figure_without_a_complaint(tmp_path: Path) -> None:
    run = cloudy_run("a <b>label</b> & more", regulation=True)
    others = ("no help", "grouping control, 4 inverters", "central dispatch", "a fifth scheme")
    runs = [run, *(without_estimates(run, label) for label in others)]
    path = tmp_path / "report.html"
    result = runs_result("A run", runs, figures_tables(runs), ())
    path.write_text(html_page(result))
    with browser(tmp_path) as window:
        for width_px in (800, 1280):
            window.narrow(width_px)
            window.open(path.as_uri())
            plots = "[...document.querySelectorAll('.plot')]"
            window.until(f"return {plots}.every(p => p.querySelector('.main-svg'))", "its figures")
            figures = {anchor: rest for anchor, *rest in window.run(WIDTHS)}
            assert [*figures] == [one.anchor for one in result.figures()]
            for anchor, (plot_px, is_drawn) in figures.items():
                assert is_drawn, anchor
                assert width_px - 260 < plot_px <= min(width_px, 1100), anchor
            assert window.run(CUT) == []
            assert "a <b>label</b> & more" in window.text("body")
        assert window.problems() == []


def test_headline_key_figures_and_the_first_figure_fit_into_one_screen(tmp_path: Path) -> None:
    write(tmp_path / "run", run_in_memory())
    with browser(tmp_path) as window:
        window.narrow(1280)
        window.open(write_run_report(tmp_path / "run").as_uri())
        window.until("return document.querySelector('#power-plot .main-svg')", "its figure")
        assert window.box(".headline")[1] < window.box(".key-figures")[1]
        _, top, _, height = window.box("#power-plot")
        assert top + height <= 800
        assert window.problems() == []
