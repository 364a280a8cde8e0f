"""The result of the study of clusters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from statistics import fmean, median
from typing import Final

import pandas as pd
import plotly.graph_objects as go

from studies.clusters.study import ClusterStudy, ClustersWorth
from studies.report.result import Result
from studies.report.style import SCHEMES, ReportFigure, dress
from studies.tables import Cell, Column, Table, key_column

_LEGEND: Final = (
    "Correlation: mean over the pairs that share a cluster, in the past and in the run itself.",
    "To central: share of the cycles with an inverter in need that reach the central controller; "
    "able: of those cycles in which the plant as a whole has what is asked for.",
    "Control-caused: shortfall in % of the desired energy, with the central controller acting "
    "every so many seconds; begun lacking: the part of it in periods that began with the whole "
    "plant lacking power.",
)


def study_result(study: ClusterStudy, remarks: Sequence[str]) -> Result:
    document = {
        "title": study.title,
        "remarks": remarks,
        "ways": [
            {"clusters": name, "seed": seed if name == "random" else None, **_json_row(worth)}
            for name, worths in study.ways.items()
            for seed, worth in enumerate(worths, start=1)
        ],
        "orders": [{"order": name, **_json_row(worth)} for name, worth in study.orders.items()],
        "search": study.search,
    }
    return Result(
        "Virtual neighbours and other clusters",
        [clusters_table(study), _orders_table(study)],
        document,
        lines=[f"{study.title}.", *remarks],
        conclusions=_conclusions(study),
        figures=lambda: [_shortfall_figure(study)],
    )


def _json_row(worth: ClustersWorth) -> dict[str, object]:
    return {
        **asdict(worth),
        "central_percent": worth.help.plant.central_percent,
        "central_percent_if_plant_sufficient": worth.help.plant_sufficient.central_percent,
    }


def clusters_table(study: ClusterStudy) -> Table:
    """Return a row for each way to choose clusters; for random ones mean, least and most."""
    caused = _caused_columns(study)
    columns = (
        key_column("clusters"),
        Column("correlation, past"),
        Column("correlation, run"),
        Column("to central, all", "%", 1),
        Column("to central, able", "%", 1),
        *caused,
        Column("begun lacking", caused[-1].unit),
    )
    rows: list[tuple[Cell, ...]] = []
    for name, worths in study.ways.items():
        figures = pd.DataFrame(map(_figures, worths), dtype=float)
        labels = {name: "mean"}
        if len(worths) > 1:
            labels = {f"{name}, mean of {len(worths)}": "mean", "- least": "min", "- most": "max"}
        rows += [(label, *figures.agg(how)) for label, how in labels.items()]
    return Table("Ways to choose clusters", columns, rows, _LEGEND)


def _caused_columns(study: ClusterStudy, decimals: int = 3) -> list[Column]:
    (virtual,) = study.ways["virtual"]
    return [
        Column("control-caused", f"% at {shortfall.central_period_s:g} s", decimals)
        for shortfall in virtual.shortfalls
    ]


def _figures(worth: ClustersWorth) -> tuple[float | None, ...]:
    return (
        worth.past_correlation,
        worth.run_correlation,
        worth.help.plant.central_percent,
        worth.help.plant_sufficient.central_percent,
        *(shortfall.control_caused_percent for shortfall in worth.shortfalls),
        worth.shortfalls[-1].begun_lacking_percent,
    )


def _orders_table(study: ClusterStudy) -> Table:
    """Return the control-caused shortfall of each order of help in the virtual clusters."""
    rows: list[tuple[Cell, ...]] = [
        (name, *(shortfall.control_caused_percent for shortfall in worth.shortfalls))
        for name, worth in study.orders.items()
    ]
    columns = (key_column("order"), *_caused_columns(study, decimals=4))
    return Table("Order of help in the virtual clusters", columns, rows)


def _conclusions(study: ClusterStudy) -> list[str]:
    """Say what is the same however clusters are chosen, and how virtual ones were found."""
    (virtual,) = study.ways["virtual"]
    needy, cycles = virtual.help.plant.needy, virtual.help.cycles
    lacking = needy - virtual.help.plant_sufficient.needy
    found = study.search.correlation_of_starts
    return [
        f"An inverter was in need in {needy:,} of {cycles:,} cycles; in {lacking:,} of them the "
        f"whole plant lacked power. {virtual.shortfalls[0].unavoidable_percent:.3f} % of the "
        "desired energy was out of reach of any controller.",
        f"Search for virtual clusters: {study.search.starts_at_best} of {len(found)} starts found "
        f"the best, correlation {min(found):.4f}; median {median(found):.4f}, worst "
        f"{max(found):.4f}.",
    ]


def _shortfall_figure(study: ClusterStudy) -> ReportFigure:
    """Draw the control-caused shortfall of each way to choose clusters, period by period."""
    figure = go.Figure()
    for colour, (name, worths) in zip(SCHEMES, study.ways.items(), strict=False):
        of_periods = list(zip(*(worth.shortfalls for worth in worths), strict=True))
        figure.add_bar(
            x=[f"{one.central_period_s:g} s" for one, *_ in of_periods],
            y=[fmean(one.control_caused_percent for one in seeds) for seeds in of_periods],
            name=name,
            marker={"color": colour},
            hovertemplate="%{y:.4f} %",
        )
    figure = dress(figure, 380)
    figure.update_layout(barmode="group", bargap=0.3)
    figure.update_xaxes(type="category", title_text="the central controller acts every")
    figure.update_yaxes(title_text="control-caused shortfall [% of desired]", rangemode="tozero")
    return ReportFigure(
        "shortfall",
        "What a slow central controller costs",
        "Shortfall that control caused, in % of the desired energy; of random clusters the mean.",
        figure,
    )
