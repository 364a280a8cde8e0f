"""The report of a run, or of several control schemes on the same plant and day."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from bus_schemas.errors import InputError
from recordings.read.series import RunSeries
from recordings.read.whole_file import whole_file
from studies.report.cloud_passage import clusters
from studies.report.inverter_figures import help_energy, residuals
from studies.report.neighbour_figures import correlation_matrices, virtual_neighbours
from studies.report.page import html_page
from studies.report.plant_figures import delivered_and_support, possible_power
from studies.report.style import ReportFigure
from studies.report.tracking_figures import regulation, tracking_error
from studies.tables import Table

_WHY_ABSENT: Final = {
    "regulation": "No regulation was asked for.",
    "residuals": "No scheme here has residuals, so there is no figure of them.",
    "neighbours": "There is no figure of two virtual neighbours: of no pair that is the least "
    "correlated of its cluster in an hour does one fall below its request while the other has "
    "power to spare.",
    "correlation": "There is no figure of correlations: the power of no inverter varies.",
}


def write_report(
    path: Path,
    title: str,
    series: Sequence[RunSeries],
    tables: Sequence[Table] = (),
    notes: Sequence[str] = (),
) -> None:
    """Write a report as one HTML file, which opens without a network.

    Parameters
    ----------
    path
        The file. It appears whole or not at all; one that is there is replaced.
    title
        Heading of the page, plain text.
    series
        One run; or several of the same plant in the same cycles, each with a label of its own.
    tables
        Tables to stand before the figures.
    notes
        Paragraphs after the first one, plain text.

    Raises
    ------
    InputError
        There is nothing to report, or the runs do not belong together.
    """
    check_destination(path)
    check_comparable(series)
    figures = report_figures(series)
    text = [introduction(series), *notes, *_absent(figures)]
    write_whole(path, html_page(title, text, [*tables, *figures]))


def check_destination(path: Path) -> None:
    """Refuse a place where no report can be written, before any work is done.

    Raises
    ------
    InputError
        It is a folder, or it lies in none.
    """
    if path.is_dir() or not path.parent.is_dir():
        raise InputError(f"report {path}: accepted is a file in an existing folder")


def check_comparable(series: Sequence[RunSeries]) -> None:
    """Refuse runs that one report cannot show side by side.

    Raises
    ------
    InputError
        There is no run, one has no cycle, two have the same label, or one differs from the first
        in its inverters or in its cycles.
    """
    if not series:
        raise InputError("report: no run is given, accepted is one or more")
    first = series[0]
    labels = [one.label for one in series]
    for one in series:
        if one.cycles == 0:
            raise InputError(f"report: {one.label} has no cycle, accepted is a run of one or more")
        if labels.count(one.label) > 1:
            raise InputError(f"report: two runs are called {one.label!r}, labels must differ")
        if one.inverters != first.inverters:
            raise InputError(
                f"report: the inverters of {one.label} are not those of {first.label},"
                " accepted are runs of the same plant"
            )
        if _clock(one) != _clock(first):
            raise InputError(
                f"report: {one.label} has {_when(one)} and {first.label} has {_when(first)},"
                " accepted are runs of the same cycles"
            )


def introduction(series: Sequence[RunSeries]) -> str:
    """Return the first paragraph: what was run, when, and for how many cycles."""
    first = series[0]
    named = [name for name in clusters(first) if name]
    grouped = f" in {_count(len(named), 'cluster')} ({', '.join(named)})" if named else ""
    schemes = (
        f"under the control scheme {first.label}"
        if len(series) == 1
        else f"under one sky and {len(series)} control schemes in turn "
        f"({'; '.join(one.label for one in series)})"
    )
    return (
        f"A plant of {_count(len(first.inverters), 'inverter')}{grouped} with "
        f"{first.rating_kw.sum():,.0f} kW of AC rating, {schemes}: {_when(first)}. "
        f"Times are local ({first.timezone})."
    )


def report_figures(series: Sequence[RunSeries]) -> list[ReportFigure]:
    """Draw all figures that these runs have something to show in.

    Signals of the single inverters are drawn of the last run whose scheme has residuals: those of
    the others, under the same sky, would look alike.

    Parameters
    ----------
    series
        Runs that have passed `check_comparable`.
    """
    figures: list[ReportFigure | None] = [
        possible_power(series),
        delivered_and_support(series),
        tracking_error(series),
        regulation(series),
    ]
    signalling = next(
        (one for one in reversed(series) if not np.isnan(one.residual_kw).all()), None
    )
    if signalling is not None:
        of_signals = residuals(signalling), virtual_neighbours(signalling)
        figures += [_named(figure, signalling, series) for figure in of_signals]
    figures += [correlation_matrices(series[0]), help_energy(series)]
    return [figure for figure in figures if figure is not None]


def _absent(figures: Sequence[ReportFigure]) -> list[str]:
    """Return a paragraph that says why figures are missing, if any are."""
    there = {figure.anchor for figure in figures}
    reasons = [reason for anchor, reason in _WHY_ABSENT.items() if anchor not in there]
    return [" ".join(reasons)] if reasons else []


def _named(
    figure: ReportFigure | None, one: RunSeries, series: Sequence[RunSeries]
) -> ReportFigure | None:
    """Say which of several runs a figure is of."""
    if figure is None or len(series) == 1:
        return figure
    return replace(figure, caption=f"Under the scheme {one.label}. {figure.caption}")


def _clock(one: RunSeries) -> tuple[int, float, int]:
    return one.start_time_ns, one.cycle_s, one.cycles


def _when(one: RunSeries) -> str:
    """Return the time of a run in words."""
    begin = one.times[0]
    end = begin + pd.Timedelta(seconds=one.cycles * one.cycle_s)
    last = f"{end:%H:%M:%S}" if end.date() == begin.date() else f"{end.day} {end:%B %Y %H:%M:%S}"
    return (
        f"{_count(one.cycles, 'cycle')} of {one.cycle_s:g} s, {begin.day} {begin:%B %Y}, "
        f"{begin:%H:%M:%S} to {last} {begin:%Z}"
    )


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


def write_whole(path: Path, text: str) -> None:
    """Write a page, which appears whole or not at all, see `whole_file`."""
    with whole_file(path) as file:
        file.write(text.encode())
