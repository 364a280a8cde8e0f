"""The report of a run, or of several control schemes on the same plant and day."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import pandas as pd
import plotly.graph_objects as go
from rich.console import Console
from rich.markup import escape

from agents.plan import RunPlan
from bus_schemas.tree import ROOT, parent_of
from bus_schemas.whole_file import whole_file
from recordings.read.reader import RunReader
from recordings.read.run_clock import RunClock
from recordings.read.series import RunSeries, plant_series_of, series_of
from results.answers import answers, answers_tables, judged
from results.figures import Figures, run_figures
from results.headline import headline, percent
from results.highlights import highlights
from results.plants import plant_figures, plants_tables
from results.report.help import HelpBetween, help_table
from results.report.inverter_figures import MOST_INVERTERS, correlation_matrices, residuals
from results.report.marks import Mark, mark, run_marks
from results.report.moments import moments
from results.report.page import html_page
from results.report.plant_figures import plant_power, regulation, storage
from results.report.result import KeyFigure, Result
from results.report.style import ReportFigure
from results.report.tables import devices_tables, figures_tables, health_table
from results.run_document import outcome_of, overview_of
from results.tables import Table, counted
from scenarios.scenario import AnswerBudgets
from sunspec.process import read_accounts

REPORT_NAME: Final = "report.html"

_SEVERAL_HOURS_S: Final = 3 * 3600.0
"""A shorter run has too few hours to compare their correlations."""


def write_run_report(run: Path, out: Path | None = None) -> Path:
    """Write the report of a recorded run, by default beside its recording; return where it is."""
    console = Console(stderr=True)
    with RunReader(run) as reader:
        path, plan = out or reader.path.with_name(REPORT_NAME), reader.plan
        notes = _notes(reader)
        title = reader.scenario_table().get("title", plan.plant)
        size_mb = reader.path.stat().st_size / 1e6
        with console.status(escape(f"reading {size_mb:,.0f} MB of {run}")):
            found = HelpBetween(plan, _nodes_drawn(plan))
            series = series_of(reader, MOST_INVERTERS, [found])
            series = replace(series, label=f"hierarchical ({plan.control.scheme})")
            overview, outcome = overview_of(reader), outcome_of(reader)
            tables = [
                *figures_tables([series]),
                *plants_tables([*plant_figures(series)]),
                *answers_tables(judged(answers(series), _budgets(reader))),
                help_table(found, reader.clock),
                health_table(overview, reader.clock, outcome),
                *devices_tables(read_accounts(reader.path.parent)),
            ]
            marks, clock = run_marks(reader, overview, series), reader.clock
    with console.status("drawing"):
        lines = [f"Run {plan.run_id}. {run_line(plan)}", *notes]
        result = runs_result(title, [series], tables, lines, marks=marks)
        page = html_page(_with_first_screen(result, series, clock))
    with whole_file(path) as file:
        file.write(page.encode())
    return path


def power_figure(reader: RunReader) -> go.Figure:
    """Draw the first figure of a run's report alone."""
    series, overview = plant_series_of(reader), overview_of(reader)
    figure = plant_power([series]).figure
    mark(figure, series, run_marks(reader, overview, series))
    return figure


def _nodes_drawn(plan: RunPlan) -> Collection[str]:
    """Return the nodes whose help is read: of a large plant, the clusters alone."""
    nodes = [node for node in plan.tree.nodes if node != ROOT]
    if len(plan.tree.leaves) > MOST_INVERTERS:
        return [node for node in nodes if not plan.tree.is_leaf(node)]
    return nodes


def _budgets(reader: RunReader) -> AnswerBudgets | None:
    """Return the limits that the scenario of a recording states for the plant's answers."""
    with suppress(msgspec.ValidationError):
        return msgspec.convert(reader.scenario_table().get("answers"), AnswerBudgets | None)
    return None


def _notes(reader: RunReader) -> list[str]:
    """Return what the recording, and the summary beside it, say about the run."""
    origin = reader.metadata.get("run", {})
    notes = [
        f"Recorded by heliarch {origin.get('driver', '')}, "
        f"version {origin.get('version heliarch', 'unknown')}, in {reader.path.name}.",
    ]
    outcome = outcome_of(reader)
    notes += outcome.document.remarks if outcome.document else ()
    if outcome.text != "over":
        notes.append(f"How the run ended: {outcome.text}.")
    if not reader.whole:
        notes.append("The recording is incomplete: the report shows the part that it holds.")
    return notes


def runs_result(
    title: str,
    series: Sequence[RunSeries],
    tables: Sequence[Table],
    lines: Sequence[str],
    document: object = None,
    *,
    marks: Sequence[Mark] = (),
    names_gaps: bool = True,
) -> Result:
    """Return one run, or several of the same plant in the same cycles, each with its own label.

    marks: What happened in the run, marked in the figures over time.
    names_gaps: Say how many cycles are not in the recording.
    """
    lines = [*lines, f"{series[0].rating_kw:,.0f} kW AC rating. {when(series[0])}, local time."]
    lines += _gap_lines(series) if names_gaps else ()
    return Result(title, tables, document, lines=lines, figures=partial(_figures, series, marks))


def _with_first_screen(result: Result, series: RunSeries, clock: RunClock) -> Result:
    """Let the page of a run begin with what it was worth and when it was hard."""
    if not series.known.any():
        return result
    figures = run_figures(series)
    return replace(
        result,
        headline=f"{headline(figures).capitalize()}.",
        key_figures=tuple(_key_figures(figures)),
        moments=tuple(moments(highlights(series).hard_minutes, series.plan, clock)),
    )


def _key_figures(figures: Figures) -> Iterator[KeyFigure]:
    """Yield the four numbers that a plant's owner asks for."""
    alone = figures["without-help"]
    missed = "" if alone is None else f"without help: {percent(alone)}"
    left_kwh = f"the price of the promise: {figures['curtailed-energy']:,.0f} kWh"
    for name, title, note in (
        ("control-caused", "of the promise missed although there was power", missed),
        ("unavoidable", "of the promise denied by the sky", "no controller could have given it"),
        ("over-delivered", "given too much", f"{figures['over-delivered-energy']:,.1f} kWh"),
        ("curtailed", "of the available energy left unused", left_kwh),
    ):
        if (value := figures[name]) is not None:
            yield KeyFigure(percent(value), title, note)


def run_line(plan: RunPlan) -> str:
    """Return the first line of a report: what was run, and how."""
    clusters = counted(len({parent_of(leaf) for leaf in plan.tree.leaves}), "cluster")
    pace = "lockstep"
    if not plan.timing.lockstep:
        pace = f"pace {plan.timing.cycle_ns / plan.timing.cycle_wall_ns:g}"
    sky = "measured irradiance" if plan.site.seed is None else f"seed {plan.site.seed}"
    parts = (
        f"Scenario {plan.plant}: {counted(len(plan.inverters), 'inverter')} in {clusters}",
        f"scheme {plan.control.scheme}",
        f"actuator {plan.control.actuator}",
        pace,
        *(() if plan.plants else (sky,)),  # Each plant of a fleet has a sky of its own.
    )
    return ", ".join(parts) + "."


def _gap_lines(series: Sequence[RunSeries]) -> Iterator[str]:
    for one in series:
        known, planned = int(one.known.sum()), one.plan.timing.cycles
        if known < planned:
            yield (
                f"{one.label}: {known:,} of {planned:,} cycles have dispatch and production in the "
                "recording. The others are gaps in the figures and do not count in the tables."
            )


def _figures(series: Sequence[RunSeries], marks: Sequence[Mark]) -> list[ReportFigure]:
    """Draw all figures that these runs have something to show in.

    Signals of the single inverters are drawn of the last run whose scheme has residuals: those of
    the others, under the same sky, would look alike.
    """
    figures = [plant_power(series), regulation(series)]
    figures += [storage(one) for one in series if one.storage_power_kw.size][-1:]
    if signalling := [one for one in series if not np.isnan(one.residual_kw).all()]:
        figure = residuals(signalling[-1])
        whose = f"Under the scheme {signalling[-1].label}. " if len(series) > 1 else ""
        figures.append(replace(figure, caption=whose + figure.caption))
    for over_time in filter(None, figures):
        mark(over_time.figure, series[0], marks)
    if series[0].cycles * series[0].cycle_s >= _SEVERAL_HOURS_S:
        figures.append(correlation_matrices(series[0]))
    return [figure for figure in figures if figure is not None]


def when(one: RunSeries) -> str:
    """Return the time of a run in words."""
    begin = one.times[0]
    end = begin + pd.Timedelta(seconds=one.cycles * one.cycle_s)
    last = f"{end:%H:%M:%S}" if end.date() == begin.date() else f"{end.day} {end:%B %Y %H:%M:%S}"
    return (
        f"{counted(one.cycles, 'cycle')} of {one.cycle_s:g} s, {begin.day} {begin:%B %Y}, "
        f"{begin:%H:%M:%S} to {last} {begin:%Z}"
    )
