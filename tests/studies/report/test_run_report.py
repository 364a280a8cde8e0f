"""A report is one whole file that shows the run and needs nothing from outside."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from report_reading import Page, numbers, read_page
from synthetic_runs import TEN_O_CLOCK_HST_NS, cloudy_run, without_estimates

from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from recordings.read.series import RunSeries
from studies.report.page import html_page
from studies.report.run_report import run_line, runs_result
from studies.report.tables import metrics_tables
from studies.tables import Column, Table, key_column

NASTY = "a <b>bold</b> & <script>alert('x')</script> label"
TEN_O_CLOCK_LOCAL_MS = TEN_O_CLOCK_HST_NS / 1e6 - 10 * 3_600_000
FIGURES = ["possible-power", "support", "regulation", "residuals", "neighbours", "correlation"]


def report(folder: Path, *series: RunSeries, notes: Sequence[str] = ()) -> Page:
    """The report of some runs, written and read again."""
    path = folder / "report.html"
    result = runs_result("A run", series, metrics_tables(series), notes)
    path.write_text(html_page(result))
    return read_page(path.read_text(encoding="utf-8"))


# What is in it ------------------------------------------------------------------------------------


def test_a_run_with_regulation_has_every_figure_and_links_to_each(tmp_path: Path) -> None:
    page = report(tmp_path, cloudy_run(regulation=True))
    assert page.figures() == FIGURES
    assert all(page.texts("figcaption"))
    places = {element.attributes.get("id") for element in page.of("section")}
    links = [str(element.attributes["href"]).removeprefix("#") for element in page.of("a")]
    assert links == [*FIGURES, "table-1", "table-2"]
    assert set(links) == places


def test_what_a_run_does_not_have_is_left_out(tmp_path: Path) -> None:
    page = report(tmp_path, without_estimates(cloudy_run(), "no help"))
    assert page.figures() == ["possible-power", "support", "correlation"]


def test_the_first_line_says_what_was_run() -> None:
    plan = prepare(load_scenario("oahu"), RunOptions(duration="5", seed=4), "r").plan
    line = run_line(plan)
    for word in (
        "oahu",
        "17 inverters",
        "3 clusters",
        plan.scheme,
        plan.actuator,
    ):
        assert word in line
    assert line.endswith("lockstep, seed 4.")
    measured = structs.replace(plan, seed=None, cycle_wall_ns=plan.cycle_ns // 10)
    assert "pace 10, measured" in run_line(measured)


def test_the_page_says_when_and_how_long(tmp_path: Path) -> None:
    run = cloudy_run("grouping", cycles=15, cycle_s=3600.0)
    first, second, *_ = report(tmp_path, run, notes=["Under a microscope."]).texts("p")
    assert first == "Under a microscope."
    assert "500 kW" in second
    assert "15 cycles of 3600 s, 1 April 2010, 10:00:00 to 2 April 2010 01:00:00 HST" in second


def test_the_curves_are_those_of_the_run(tmp_path: Path) -> None:
    run = cloudy_run()
    page = report(tmp_path, run)
    for name in ("possible", "delivered", "commitment"):
        drawn_kw = numbers(page.trace("possible-power", name)["y"])
        np.testing.assert_allclose(drawn_kw, getattr(run, f"{name}_kw"), rtol=1e-6)
    support = numbers(page.trace("support", "support needed")["y"])
    np.testing.assert_allclose(support, run.support_kw, rtol=1e-6, atol=1e-5)
    axis = page.figure("possible-power")["layout"]["xaxis"]
    assert axis["range"] == [TEN_O_CLOCK_LOCAL_MS, TEN_O_CLOCK_LOCAL_MS + 900_000]
    assert axis["title"]["text"] == "local time (HST)"


def test_a_line_of_a_few_points_keeps_peaks_dips_ends_and_gaps(tmp_path: Path) -> None:
    run = cloudy_run(cycles=20_003)
    power_kw, residual_kw = run.power_kw.copy(), run.residual_kw.copy()
    power_kw[12_345], power_kw[7_654], residual_kw[20_002, 0] = 0.5, 400.0, -500.0
    # Neither end is an extreme.
    power_kw[[1, 20_001]], power_kw[[2, 20_000]] = 0.6, 390.0
    power_kw[15_000:15_100] = np.nan
    page = report(tmp_path, replace(run, power_kw=power_kw, residual_kw=residual_kw))
    delivered = page.trace("support", "delivered")
    seconds = (numbers(delivered["x"]) - TEN_O_CLOCK_LOCAL_MS) / 1000.0
    drawn_kw = dict(zip(seconds.tolist(), numbers(delivered["y"]).tolist(), strict=True))
    assert (drawn_kw[12_345], drawn_kw[7_654]) == pytest.approx((2.5, 2000.0))
    assert {0, 20_002} <= drawn_kw.keys()
    assert any(np.isnan(kw) for second, kw in drawn_kw.items() if 15_000 <= second < 15_100)
    assert len(drawn_kw) <= 3002
    cells = next(t for t in page.figure("residuals")["data"] if "z" in t)
    drawn = numbers(cells["z"])
    assert drawn.shape[1] <= 900
    assert drawn[0].min() == pytest.approx(-500.0)


def test_the_heat_map_has_a_row_for_each_inverter_cluster_by_cluster(tmp_path: Path) -> None:
    run = cloudy_run()
    cells = next(t for t in report(tmp_path, run).figure("residuals")["data"] if "z" in t)
    assert cells["y"] == ["c1/inv01", "c1/inv03", "c1/inv05", "c2/inv02", "c2/inv04"]
    drawn = numbers(cells["z"])
    np.testing.assert_allclose(drawn, run.residual_kw[:, [0, 2, 4, 1, 3]].T, rtol=1e-5, atol=1e-4)


def test_every_inverter_is_named(tmp_path: Path) -> None:
    names = tuple(f"z1/c{n // 5}/inv{n:03}" for n in range(120))
    page = report(tmp_path, cloudy_run(cycles=60, inverters=names))
    layout = page.figure("residuals")["layout"]
    assert layout["yaxis"]["dtick"] == 1
    assert layout["yaxis"]["automargin"]
    assert layout["height"] >= 12 * len(names)


def test_two_days_are_told_apart(tmp_path: Path) -> None:
    page = report(tmp_path, cloudy_run(cycles=25 * 9, cycle_s=400.0))
    titles = [note["text"] for note in page.figure("correlation")["layout"]["annotations"]]
    assert len(titles) == len(set(titles)) == 25
    assert (titles[0], titles[24]) == ("1 Apr, 10 h", "2 Apr, 10 h")


def test_each_scheme_has_its_panel_its_column_and_one_colour(tmp_path: Path) -> None:
    run = cloudy_run("hierarchical", regulation=True)
    page = report(tmp_path, run, without_estimates(run, "no help"))
    layout = page.figure("support")["layout"]
    assert [note["text"] for note in layout["annotations"]] == ["hierarchical", "no help"]
    assert layout["yaxis2"]["matches"] == "y"
    lines = [
        page.trace("possible-power", "delivered, no help")["line"],
        page.trace("support", "delivered, no help")["line"],
        page.trace("regulation", "given, no help")["line"],
    ]
    assert len({line["color"] for line in lines}) == 1
    assert page.trace("support", "delivered, hierarchical")["line"]["color"] != lines[0]["color"]
    assert page.texts("th").count("hierarchical") == page.texts("th").count("no help") == 2


# That it is safe ----------------------------------------------------------------------------------


def test_labels_are_text_and_never_markup(tmp_path: Path) -> None:
    run = cloudy_run(NASTY)
    path = tmp_path / "report.html"
    table = Table(NASTY, (key_column(NASTY), Column(NASTY, NASTY)), ((NASTY, NASTY),), (NASTY,))
    runs = [run, without_estimates(run, "other")]
    path.write_text(html_page(runs_result(NASTY, runs, [table], [NASTY])))
    page = read_page(path.read_text(encoding="utf-8"))
    assert "b" not in {element.tag for element in page.elements}
    assert page.texts("h1") == page.texts("td") == [NASTY]
    assert page.texts("p").count(NASTY) == 2
    # Plotly reads mark-up of its own out of texts: it is given entities.
    names = [trace["name"] for trace in page.figure("possible-power")["data"]]
    assert names[1].startswith("delivered, a &lt;b&gt;bold&lt;/b&gt; &amp; ")


def test_the_page_loads_nothing_and_has_plotly_once(tmp_path: Path) -> None:
    page = report(tmp_path, cloudy_run(regulation=True))
    for element in page.elements:
        assert element.tag not in {"link", "iframe", "img", "object", "base"}
        assert not {"src", "srcset", "action", "data"} & element.attributes.keys()
        assert str(element.attributes.get("href", "#")).startswith("#")
    assert not re.search(r"url\(|@import", page.of("style")[0].text)
    (policy,) = [e for e in page.of("meta") if "http-equiv" in e.attributes]
    assert str(policy.attributes["content"]).startswith("default-src 'none';")
    assert sum("plotly.js v" in script.text for script in page.of("script")) == 1


# Incomplete, small and odd runs -------------------------------------------------------------------


@pytest.mark.parametrize(
    "fields", [("commitment_kw", "regulation_kw"), ("mpp_kw", "power_kw"), ("impp_kw", "alpha")]
)
def test_cycles_without_a_message_are_gaps_in_their_own_place(
    tmp_path: Path, fields: tuple[str, ...]
) -> None:
    run = cloudy_run(regulation=True)
    gaps = {field: getattr(run, field).copy() for field in fields}
    for values in gaps.values():
        values[100:130] = np.nan
    found = replace(run, **gaps)
    page = report(tmp_path, found)
    assert page.figures() == FIGURES
    drawn = numbers(page.trace("possible-power", "delivered")["y"])
    np.testing.assert_allclose(drawn, found.delivered_kw, rtol=1e-6)
    said = any("30 cycles without dispatch or production" in text for text in page.texts("p"))
    assert said == (found.known.sum() == 870)


@pytest.mark.parametrize("cycles", [1, 61])
def test_a_run_of_a_few_cycles_of_one_inverter_has_a_report(tmp_path: Path, cycles: int) -> None:
    page = report(tmp_path, cloudy_run(cycles=cycles, regulation=True, inverters=("alone",)))
    assert len(numbers(page.trace("possible-power", "delivered")["y"])) == cycles


def test_a_night_has_a_report(tmp_path: Path) -> None:
    run = cloudy_run()
    dark = np.zeros_like(run.mpp_kw)
    none = np.zeros(run.cycles)
    night = replace(run, commitment_kw=none, mpp_kw=dark, power_kw=dark, impp_kw=dark)
    night = replace(night, residual_kw=dark, alpha=dark + 1.0)
    assert "correlation" not in report(tmp_path, night).figures()
