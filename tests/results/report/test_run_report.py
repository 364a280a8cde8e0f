"""A report is one whole file that shows the run and needs nothing from outside."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest
from plans_by_hand import with_changes
from plotly.offline import get_plotlyjs_version
from synthetic_runs import TEN_O_CLOCK_HST_NS, cloudy_run, without_estimates

import results.report
from recordings.read.series import RunSeries
from results.report.page import html_page
from results.report.run_report import runs_result
from results.report.style import clock_ms
from results.report.tables import figures_tables
from results.tables import Column, Table, key_column

NASTY = "a <b>bold</b> & <script>alert('x')</script> label"
TEN_O_CLOCK_LOCAL_MS = TEN_O_CLOCK_HST_NS / 1e6 - 10 * 3_600_000
FIGURES = ["power", "regulation", "residuals"]


@dataclass
class Element:
    tag: str
    attributes: dict[str, str | None]
    text: str = ""


class Page(HTMLParser):
    """A page as a browser reads it: its elements, in the order in which they begin."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[Element] = []
        self._open: list[Element] = []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append(Element(tag, dict(attrs)))
        if tag != "meta":
            self._open.append(self.elements[-1])

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop().tag == tag

    def handle_data(self, data: str) -> None:
        if self._open:
            self._open[-1].text += data

    def of(self, tag: str) -> list[Element]:
        return [element for element in self.elements if element.tag == tag]

    def texts(self, tag: str) -> list[str]:
        return [element.text for element in self.of(tag)]


def figures_of(*series: RunSeries) -> dict[str, go.Figure]:
    """The figures in the report of some runs, by the names of their places in the page."""
    return {one.anchor: one.figure for one in runs_result("A run", series, (), ()).figures()}


def trace(figure: go.Figure, name: str) -> go.Scatter:
    """The first trace of a name in a figure."""
    return next(one for one in figure.data if one.name == name)


def page_of(*series: RunSeries, notes: tuple[str, ...] = ()) -> Page:
    """The report of some runs, read as a page."""
    return Page(html_page(runs_result("A run", series, figures_tables(series), notes)))


# What is in it ------------------------------------------------------------------------------------


def test_the_page_has_every_figure_with_its_data_and_links_to_each() -> None:
    page = page_of(cloudy_run(regulation=True))
    plots = [str(one.attributes["id"]) for one in page.of("div") if "id" in one.attributes]
    assert plots == [f"{anchor}-plot" for anchor in FIGURES]
    data = {one.attributes.get("id"): one.text for one in page.of("script")}
    assert all(json.loads(data[f"{plot}-data"])["data"] for plot in plots)
    assert all(page.texts("figcaption"))
    links = [str(element.attributes["href"]).removeprefix("#") for element in page.of("a")]
    assert links == [*FIGURES, "table-1", "table-2"]
    assert set(links) <= {element.attributes.get("id") for element in page.of("section")}


def test_the_curves_are_those_of_the_run() -> None:
    run = cloudy_run(regulation=True)
    power = figures_of(run)["power"]
    curves = {
        "available": run.available_kw,
        "delivered": run.delivered_kw,
        "dispatch": run.dispatch_kw,
        "commitment": run.commitment_kw,
        "delivered without help": run.without_help_kw,
        "deviation": run.delivered_kw - run.dispatch_kw,
        "deviation without help": run.without_help_kw - run.dispatch_kw,
        "denied by the sky": np.minimum(run.available_kw - run.dispatch_kw, 0.0),
    }
    for name, expected_kw in curves.items():
        line = trace(power, name)
        np.testing.assert_allclose(line.y, expected_kw, rtol=1e-6, atol=1e-3, err_msg=name)
        below = name.startswith(("deviation", "denied"))
        assert line.yaxis == ("y2" if below else "y"), "a deviation has an axis of its own"
    axis = power.layout.xaxis2
    assert axis.range == (TEN_O_CLOCK_LOCAL_MS, TEN_O_CLOCK_LOCAL_MS + 900_000)
    assert axis.title.text == "local time (HST)"


def test_a_line_of_a_few_points_keeps_peaks_dips_ends_and_gaps() -> None:
    run = cloudy_run(cycles=20_003)
    power_kw, residual_kw = run.power_kw.copy(), run.residual_kw.copy()
    power_kw[12_345], power_kw[7_654], residual_kw[20_002, 0] = 0.5, 400.0, -500.0
    # Neither end is an extreme.
    power_kw[[1, 20_001]], power_kw[[2, 20_000]] = 0.6, 390.0
    power_kw[15_000:15_100] = np.nan
    figures = figures_of(replace(run, power_kw=power_kw, residual_kw=residual_kw))
    delivered = trace(figures["power"], "delivered")
    seconds = (delivered.x - TEN_O_CLOCK_LOCAL_MS) / 1000.0
    drawn_kw = dict(zip(seconds.tolist(), delivered.y.tolist(), strict=True))
    assert (drawn_kw[12_345], drawn_kw[7_654]) == pytest.approx((2.5, 2000.0))
    assert {0, 20_002} <= drawn_kw.keys()
    assert any(np.isnan(kw) for second, kw in drawn_kw.items() if 15_000 <= second < 15_100)
    assert len(drawn_kw) <= 3002
    cells_kw = figures["residuals"].data[0].z
    assert cells_kw.shape[1] <= 900
    assert cells_kw[0].min() == pytest.approx(-500.0)


# That it is safe ----------------------------------------------------------------------------------


def test_labels_are_text_and_never_markup() -> None:
    runs = [cloudy_run(NASTY), without_estimates(cloudy_run(), "other")]
    table = Table(NASTY, (key_column(NASTY), Column(NASTY, NASTY)), ((NASTY, NASTY),), (NASTY,))
    page = Page(html_page(runs_result(NASTY, runs, [table], [NASTY])))
    assert "b" not in {element.tag for element in page.elements}
    assert page.texts("h1") == page.texts("td") == [NASTY]
    assert page.texts("p").count(NASTY) == 2
    # Plotly reads mark-up of its own out of texts: it is given entities.
    delivered = figures_of(*runs)["power"].data[1].name
    assert delivered.startswith("delivered, a &lt;b&gt;bold&lt;/b&gt; &amp; ")


def test_the_page_loads_nothing_and_has_plotly_once() -> None:
    page = page_of(cloudy_run(regulation=True))
    for element in page.elements:
        assert element.tag not in {"link", "iframe", "img", "object", "base"}
        assert not {"src", "srcset", "action", "data"} & element.attributes.keys()
        assert str(element.attributes.get("href", "#")).startswith("#")
    assert not re.search(r"url\(|@import", page.of("style")[0].text)
    (policy,) = [one for one in page.of("meta") if "http-equiv" in one.attributes]
    assert str(policy.attributes["content"]).startswith("default-src 'none';")
    assert sum("plotly.js (cartesian" in script.text for script in page.of("script")) == 1


def test_the_library_in_the_page_is_the_one_that_figures_are_written_for() -> None:
    bundled = Path(results.report.__file__).with_name("templates") / "plotly-cartesian.min.js"
    assert f"v{get_plotlyjs_version()}" in bundled.read_text(encoding="utf-8")[:200]


# Incomplete and small runs ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "fields", [("commitment_kw", "regulation_kw"), ("mpp_kw", "power_kw"), ("impp_kw", "alpha")]
)
def test_cycles_without_a_message_are_gaps_in_their_own_place(fields: tuple[str, ...]) -> None:
    run = cloudy_run(regulation=True)
    gaps = {field: getattr(run, field).copy() for field in fields}
    for values in gaps.values():
        values[100:130] = np.nan
    gapped = replace(run, **gaps)
    result = runs_result("A run", [gapped], (), ())
    figures = figures_of(gapped)
    assert [*figures] == FIGURES
    drawn = trace(figures["power"], "delivered").y
    np.testing.assert_allclose(drawn, gapped.delivered_kw, rtol=1e-6)
    said = any("870 of 900 cycles have dispatch and production" in line for line in result.lines)
    assert said == (gapped.known.sum() == 870)


# Rules of figures ---------------------------------------------------------------------------------


def test_the_clock_does_not_go_back_where_summer_time_ends() -> None:
    # Berlin, 2026-10-25: 03:00 CEST is 02:00 CET.
    run = cloudy_run(cycles=4, cycle_s=3600.0)
    begin_ns = 1_792_886_400_000_000_000
    plan = with_changes(run.plan, timezone="Europe/Berlin", start_time_ns=begin_ns)
    run = replace(run, plan=plan)
    assert run.times[0].utcoffset() != run.times[-1].utcoffset()
    assert np.diff(clock_ms(run)).tolist() == [3_600_000.0] * 3
