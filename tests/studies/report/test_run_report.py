"""A report is one whole file that holds the run's figures and reaches for nothing outside it."""

from __future__ import annotations

import re
import resource
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_reading import Page, numbers, read_page
from synthetic_runs import TEN_O_CLOCK_HST_NS, cloudy_run, without_estimates

from bus_schemas.errors import InputError
from recordings.read.series import RunSeries
from studies.report.metrics_tables import metrics_tables
from studies.report.run_report import write_report
from studies.report.tables import ReportTable

NASTY = "a <b>bold</b> & <script>alert('x')</script> label"
TEN_O_CLOCK_LOCAL_MS = TEN_O_CLOCK_HST_NS / 1e6 - 10 * 3_600_000


def report(folder: Path, *series: RunSeries, **more: list[str]) -> Page:
    """The report of some runs, written and read again."""
    path = folder / "report.html"
    write_report(path, "A run", series, metrics_tables(series), **more)
    return read_page(path.read_text(encoding="utf-8"))


# What is in it ------------------------------------------------------------------------------------


def test_a_run_with_regulation_has_every_figure(tmp_path: Path) -> None:
    page = report(tmp_path, cloudy_run(regulation=True))
    assert page.figures() == [
        "possible-power",
        "support",
        "tracking-error",
        "regulation",
        "residuals",
        "neighbours",
        "correlation",
        "help-energy",
    ]
    assert len(page.of("figcaption")) == 8
    assert all(caption for caption in page.texts("figcaption"))


def test_what_a_run_does_not_have_is_left_out_and_said(tmp_path: Path) -> None:
    page = report(tmp_path, without_estimates(cloudy_run(), "no help"))
    assert not {"regulation", "residuals", "neighbours"} & set(page.figures())
    text = " ".join(page.texts("p"))
    assert "No regulation was asked for." in text
    assert "No scheme here has residuals" in text
    assert "no figure of two virtual neighbours" in text


def test_the_first_paragraph_says_what_was_run_and_when(tmp_path: Path) -> None:
    page = report(tmp_path, cloudy_run("grouping", cycles=900), notes=["Under a microscope."])
    first, second, *_ = page.texts("p")
    assert "5 inverters in 2 clusters (c1, c2) with 500 kW" in first
    assert "control scheme grouping" in first
    assert "900 cycles of 1 s, 1 April 2010, 10:00:00 to 10:15:00 HST" in first
    assert second == "Under a microscope."


def test_a_run_past_midnight_says_on_which_day_it_ends(tmp_path: Path) -> None:
    page = report(tmp_path, cloudy_run(cycles=15, cycle_s=3600.0))
    assert "1 April 2010, 10:00:00 to 2 April 2010 01:00:00 HST" in page.texts("p")[0]


def test_a_dip_of_one_cycle_is_in_the_data_of_the_figures(tmp_path: Path) -> None:
    run = cloudy_run(cycles=20_000)
    power_kw = run.power_kw.copy()
    power_kw[12_345] = 0.5
    page = report(tmp_path, replace(run, power_kw=power_kw))
    for figure in ("possible-power", "support"):
        delivered = page.trace(figure, "delivered")
        drawn_kw, clock_ms = numbers(delivered["y"]), numbers(delivered["x"])
        assert drawn_kw.min() == pytest.approx(2.5)
        assert clock_ms[drawn_kw.argmin()] == TEN_O_CLOCK_LOCAL_MS + 12_345_000
        assert len(drawn_kw) <= 3002
    assert any("the least and the greatest value" in text for text in page.texts("figcaption"))


def test_the_curves_are_those_of_the_run(tmp_path: Path) -> None:
    run = cloudy_run()
    page = report(tmp_path, run)
    for name, power_kw in (
        ("possible", run.possible_kw),
        ("delivered", run.delivered_kw),
        ("commitment", run.commitment_kw),
    ):
        drawn = numbers(page.trace("possible-power", name)["y"])
        np.testing.assert_allclose(drawn, power_kw, rtol=1e-6)
    support = numbers(page.trace("support", "support needed")["y"])
    np.testing.assert_allclose(support, run.support_kw, rtol=1e-6, atol=1e-5)


def test_the_heat_map_has_a_row_for_each_inverter_cluster_by_cluster(tmp_path: Path) -> None:
    run = cloudy_run()
    cells = next(t for t in report(tmp_path, run).figure("residuals")["data"] if "z" in t)
    assert cells["y"] == ["c1/inv01", "c1/inv03", "c1/inv05", "c2/inv02", "c2/inv04"]
    drawn = numbers(cells["z"])
    np.testing.assert_allclose(drawn, run.residual_kw[:, [0, 2, 4, 1, 3]].T, rtol=1e-5, atol=1e-4)


def test_axes_show_local_time_from_the_first_cycle_to_the_end_of_the_last(tmp_path: Path) -> None:
    layout = report(tmp_path, cloudy_run(cycles=900)).figure("possible-power")["layout"]
    begin_ms, end_ms = layout["xaxis"]["range"]
    assert begin_ms == TEN_O_CLOCK_LOCAL_MS
    assert end_ms == TEN_O_CLOCK_LOCAL_MS + 900_000
    assert layout["xaxis"]["title"]["text"] == "local time (HST)"


def test_each_scheme_has_its_panel_its_column_and_one_colour(tmp_path: Path) -> None:
    run = cloudy_run("hierarchical", regulation=True)
    page = report(tmp_path, run, without_estimates(run, "no help"))
    layout = page.figure("support")["layout"]
    assert [note["text"] for note in layout["annotations"]] == ["hierarchical", "no help"]
    assert layout["yaxis2"]["matches"] == "y"
    names = ["delivered, no help", "given, no help"]
    lines = [
        page.trace("possible-power", names[0])["line"],
        page.trace("support", names[0])["line"],
        page.trace("tracking-error", "no help")["line"],
        page.trace("regulation", names[1])["line"],
    ]
    assert len({line["color"] for line in lines}) == 1
    assert page.trace("support", "delivered, hierarchical")["line"]["color"] != lines[0]["color"]
    assert page.texts("th").count("hierarchical") == page.texts("th").count("no help") == 2


def test_every_entry_of_the_contents_leads_somewhere(tmp_path: Path) -> None:
    page = report(tmp_path, cloudy_run(regulation=True))
    places = {element.attributes.get("id") for element in page.of("section")}
    links = [str(element.attributes["href"]) for element in page.of("a")]
    assert {link.removeprefix("#") for link in links} == places
    assert len(links) == len(page.of("h2")) == 10


def test_tables_are_shown_with_their_units_and_notes(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    table = ReportTable("Ramps", ("one",), (("Largest rise", "kW/min", ("12.5",)),), "A note.")
    write_report(path, "A run", [cloudy_run("one")], [table])
    page = read_page(path.read_text(encoding="utf-8"))
    assert page.texts("td") == ["kW/min", "12.5"]
    assert "A note." in page.texts("p")


# That it is safe ----------------------------------------------------------------------------------


def test_labels_are_text_and_never_markup(tmp_path: Path) -> None:
    run = cloudy_run(NASTY)
    path = tmp_path / "report.html"
    table = ReportTable(NASTY, (NASTY,), ((NASTY, NASTY, (NASTY,)),), NASTY)
    write_report(path, NASTY, [run, without_estimates(run, "other")], [table], [NASTY])
    page = read_page(path.read_text(encoding="utf-8"))
    assert "b" not in {element.tag for element in page.elements}
    assert page.texts("h1") == [NASTY]
    assert NASTY in page.texts("p")
    assert page.texts("td") == [NASTY, NASTY]
    # Plotly reads mark-up of its own out of texts: it is given entities.
    names = [trace["name"] for trace in page.figure("tracking-error")["data"]]
    assert names[0].startswith("a &lt;b&gt;bold&lt;/b&gt; &amp; ")


def test_the_page_loads_nothing(tmp_path: Path) -> None:
    page = report(tmp_path, cloudy_run(regulation=True))
    for element in page.elements:
        assert element.tag not in {"link", "iframe", "img", "object", "base"}
        assert not {"src", "srcset", "action", "data"} & element.attributes.keys()
        assert str(element.attributes.get("href", "#")).startswith("#")
    assert not re.search(r"url\(|@import", page.of("style")[0].text)
    (policy,) = [e for e in page.of("meta") if "http-equiv" in e.attributes]
    assert str(policy.attributes["content"]).startswith("default-src 'none';")


def test_plotly_is_in_the_page_once(tmp_path: Path) -> None:
    scripts = report(tmp_path, cloudy_run()).of("script")
    assert sum("plotly.js v" in script.text for script in scripts) == 1


def test_the_report_of_a_day_of_17_inverters_is_below_12_mb(tmp_path: Path) -> None:
    inverters = tuple(f"c{n % 3}/inv{n:02d}" for n in range(17))
    run = cloudy_run(cycles=54_000, inverters=inverters, regulation=True)
    report(tmp_path, run, without_estimates(run, "b"), without_estimates(run, "c"))
    assert (tmp_path / "report.html").stat().st_size < 12e6


# Small and odd runs -------------------------------------------------------------------------------


@pytest.mark.parametrize("cycles", [1, 2, 61])
def test_a_run_of_a_few_cycles_has_a_report(tmp_path: Path, cycles: int) -> None:
    page = report(tmp_path, cloudy_run(cycles=cycles, regulation=True))
    assert "possible-power" in page.figures()
    assert len(numbers(page.trace("possible-power", "delivered")["y"])) == cycles


def test_a_plant_of_one_inverter_without_clusters_has_a_report(tmp_path: Path) -> None:
    page = report(tmp_path, cloudy_run(inverters=("alone",)))
    assert "A plant of 1 inverter with 100 kW" in page.texts("p")[0]


def test_a_night_has_a_report(tmp_path: Path) -> None:
    run = cloudy_run()
    dark = np.zeros_like(run.mpp_kw)
    night = replace(
        run,
        commitment_kw=np.zeros(run.cycles),
        mpp_kw=dark,
        power_kw=dark,
        impp_kw=dark,
        residual_kw=dark,
        alpha=dark + 1.0,
    )
    page = report(tmp_path, night)
    assert "correlation" not in page.figures()
    assert "the power of no inverter varies" in " ".join(page.texts("p"))


# Bad input ----------------------------------------------------------------------------------------


def refused(tmp_path: Path, *series: RunSeries) -> str:
    """The one line with which runs are refused; nothing is left behind."""
    with pytest.raises(InputError) as caught:
        write_report(tmp_path / "report.html", "A run", series)
    assert list(tmp_path.iterdir()) == []
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_no_run_is_refused(tmp_path: Path) -> None:
    assert refused(tmp_path) == "report: no run is given, accepted is one or more"


def test_an_empty_run_is_refused(tmp_path: Path) -> None:
    run = replace(cloudy_run("empty"), mpp_kw=np.empty((0, 5)))
    assert refused(tmp_path, run) == "report: empty has no cycle, accepted is a run of one or more"


def test_two_runs_of_one_name_are_refused(tmp_path: Path) -> None:
    assert "two runs are called 'a', labels must differ" in refused(
        tmp_path, cloudy_run("a"), cloudy_run("a")
    )


def test_runs_of_two_plants_are_refused(tmp_path: Path) -> None:
    other = cloudy_run("b", inverters=("x", "y"))
    assert "the inverters of b are not those of a" in refused(tmp_path, cloudy_run("a"), other)


def test_runs_of_different_cycles_are_refused(tmp_path: Path) -> None:
    found = refused(tmp_path, cloudy_run("a"), cloudy_run("b", cycles=30))
    assert "b has 30 cycles of 1 s" in found
    assert "a has 900 cycles of 1 s" in found


@pytest.mark.parametrize("place", [".", "missing/report.html"])
def test_a_place_where_no_file_can_be_is_refused(tmp_path: Path, place: str) -> None:
    path = tmp_path / place
    with pytest.raises(InputError, match="accepted is a file in an existing folder") as caught:
        write_report(path, "A run", [cloudy_run()])
    assert str(path) in str(caught.value)


def test_a_report_that_cannot_be_written_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("the old one")

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))  # As a disk that fills up.
    try:
        with pytest.raises(InputError, match="File too large"):
            write_report(path, "A run", [cloudy_run()])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_text() == "the old one"
    assert list(tmp_path.iterdir()) == [path]


def test_a_table_with_a_value_too_few_is_refused() -> None:
    with pytest.raises(ValueError, match="row 'energy': 1 values for 2 columns"):
        ReportTable("Table", ("a", "b"), (("energy", "kWh", ("1",)),))
