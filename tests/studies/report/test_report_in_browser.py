"""A browser draws every figure of a report and has nothing to complain about."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from report_reading import read_page
from synthetic_runs import cloudy_run, without_estimates

from studies.report.run_report import report_page
from studies.report.tables import metrics_tables

WIDTHS = """<script>addEventListener("load", () => {
  const seen = document.documentElement.clientWidth;
  const cut = [...document.querySelectorAll("table, p, h1, h2, .plot, svg text, .scroll")].filter(
    (e) => e.getBoundingClientRect().right > seen + 1 ||
      (e.className === "scroll" && e.scrollWidth > e.clientWidth + 1));
  document.body.dataset.cut = cut.map((e) => e.tagName + " " + e.textContent.slice(0, 40)).join();
})</script></body>"""
"""Notes in the page what reaches beyond its right edge."""

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
QUIET = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
    "--enable-logging=stderr",
    "--virtual-time-budget=8000",
)


@pytest.fixture(scope="module")
def browser() -> str:
    """Path of a browser; the test is skipped where there is none."""
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip(f"no browser on this machine: none of {', '.join(BROWSERS)}")
    return found


@pytest.mark.parametrize("width_px", [800, 1280])
def test_a_browser_draws_every_figure_without_a_complaint(
    browser: str, tmp_path: Path, width_px: int
) -> None:
    run = cloudy_run("a <b>label</b> & more", regulation=True)
    others = ("no help", "grouping control, 4 inverters", "central dispatch", "a fifth scheme")
    runs = [run, *(without_estimates(run, label) for label in others)]
    path = tmp_path / "report.html"
    path.write_text(report_page("A run", runs, metrics_tables(runs)))
    measured = path.with_name("measured.html")
    measured.write_text(path.read_text(encoding="utf-8").replace("</body>", WIDTHS), "utf-8")
    ended = subprocess.run(
        [
            browser,
            *QUIET,
            f"--user-data-dir={tmp_path / 'browser'}",
            f"--window-size={width_px},1000",
            "--dump-dom",
            measured.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    console = [line for line in ended.stderr.splitlines() if "CONSOLE" in line]
    assert console == []
    assert 'data-cut=""' in ended.stdout, re.findall(r'data-cut="[^"]*"', ended.stdout)
    figures = read_page(path.read_text(encoding="utf-8")).figures()
    for anchor in figures:
        drawn = ended.stdout.split(f'id="{anchor}-plot"')[1].split("<figcaption>")[0]
        assert 'class="main-svg"' in drawn, anchor
        assert re.search(r'class="(point|js-line|hm)"|<image|class="[^"]*trace', drawn), anchor
        width = re.search(r'class="main-svg"[^>]* width="([\d.]+)"', drawn)
        assert width is not None, anchor
        assert width_px - 260 < float(width[1]) <= min(width_px, 1100), anchor
    assert "a &lt;b&gt;label&lt;/b&gt; &amp; more" in ended.stdout
