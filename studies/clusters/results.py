"""The result of the study of clusters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from math import isnan
from statistics import fmean, median
from typing import Final

import numpy as np
import plotly.graph_objects as go

from studies.clusters.study import ClusterStudy, ClustersWorth
from studies.report.result import Result
from studies.report.style import BLACK, SCHEMES, ReportFigure, dress
from studies.tables import Cell, Column, Table, key_column, word_column

_LEGEND: Final = (
    "Correlation: mean over the pairs that share a cluster, in the past and in the run itself.",
    "To central: share of the cycles with an inverter in need that reach the central controller; "
    "able: of those cycles in which the plant as a whole has what is asked for.",
    "Control-caused: shortfall in % of the desired energy, with the central controller acting "
    "every so many seconds; begun lacking: the part of it in periods that began with the whole "
    "plant lacking power.",
)


def study_result(study: ClusterStudy, remarks: Sequence[str]) -> Result:
    return Result(
        "Virtual neighbours and other clusters",
        [clusters_table(study), orders_table(study), members_table(study)],
        _document(study, remarks),
        lines=[f"{study.title}.", *remarks],
        conclusions=_conclusions(study),
        figures=lambda: [_shortfall_figure(study)],
    )


def clusters_table(study: ClusterStudy) -> Table:
    """Return a row for each way to choose clusters; for random ones mean, least and most."""
    columns = (
        key_column("clusters"),
        Column("correlation, past"),
        Column("correlation, run"),
        Column("to central, all", "%", 1),
        Column("to central, able", "%", 1),
        *(Column("control-caused", f"% at {period_s:g} s") for period_s in study.periods_s),
        Column("begun lacking", f"% at {study.periods_s[-1]:g} s"),
    )
    of_several: tuple[Callable[[Sequence[float]], float], ...] = (fmean, min, max)
    rows: list[tuple[Cell, ...]] = []
    for name, worths in study.ways.items():
        labels = [name]
        if len(worths) > 1:
            labels = [f"{name}, mean of {len(worths)}", "- least", "- most"]
        known = [
            [one for one in figure if one is not None and not isnan(one)]
            for figure in zip(*map(_figures, worths), strict=True)
        ]
        for label, of_many in zip(labels, of_several, strict=False):
            rows.append((label, *(of_many(figure) if figure else None for figure in known)))
    return Table("Ways to choose clusters", columns, rows, _LEGEND)


def _figures(worth: ClustersWorth) -> tuple[float | None, ...]:
    return (
        worth.past_correlation,
        worth.run_correlation,
        worth.help.plant.central_percent,
        worth.help.plant_sufficient.central_percent,
        *(shortfall.control_caused_percent for shortfall in worth.shortfalls),
        worth.shortfalls[-1].begun_lacking_percent,
    )


def orders_table(study: ClusterStudy) -> Table:
    """Return the control-caused shortfall of each order of help in the virtual clusters."""
    columns = (
        key_column("order"),
        *(Column("control-caused", f"% at {period_s:g} s", 4) for period_s in study.periods_s),
    )
    rows: list[tuple[Cell, ...]] = [
        (name, *(shortfall.control_caused_percent for shortfall in worth.shortfalls))
        for name, worth in study.orders.items()
    ]
    return Table("Order of help in the virtual clusters", columns, rows)


def members_table(study: ClusterStudy) -> Table:
    """Return the inverters of each cluster, for ways that choose the same ones each time."""
    rows = [
        (name, "; ".join(" ".join(cluster) for cluster in worths[0].members))
        for name, worths in study.ways.items()
        if len(worths) == 1
    ]
    return Table("Members", (key_column("clusters"), word_column("inverters")), rows)


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


def _document(study: ClusterStudy, remarks: Sequence[str]) -> dict[str, object]:
    return {
        "title": study.title,
        "remarks": remarks,
        "ways": [
            {
                "clusters": name,
                "seed": seed if name == "random" else None,
                **_json_row(worth),
            }
            for name, worths in study.ways.items()
            for seed, worth in enumerate(worths, start=1)
        ],
        "orders": [{"order": name, **_json_row(worth)} for name, worth in study.orders.items()],
        "search": study.search,
    }


def _json_row(worth: ClustersWorth) -> dict[str, object]:
    return {
        **asdict(worth),
        "central_percent": worth.help.plant.central_percent,
        "central_percent_if_plant_sufficient": worth.help.plant_sufficient.central_percent,
    }


def _shortfall_figure(study: ClusterStudy) -> ReportFigure:
    """Draw the control-caused shortfall of each way to choose clusters, period by period."""
    figure = go.Figure()
    for colour, (name, worths) in zip(SCHEMES, study.ways.items(), strict=False):
        percents = np.array(
            [[one.control_caused_percent for one in worth.shortfalls] for worth in worths]
        )
        means = percents.mean(axis=0)
        figure.add_bar(
            x=[f"{period_s:g} s" for period_s in study.periods_s],
            y=means.tolist(),
            name=name,
            marker={"color": colour},
            error_y={
                "type": "data",
                "symmetric": False,
                "array": (percents.max(axis=0) - means).tolist(),
                "arrayminus": (means - percents.min(axis=0)).tolist(),
                "color": BLACK,
                "thickness": 1.2,
                "visible": len(worths) > 1,
            },
            hovertemplate="%{y:.4f} %",
        )
    figure = dress(figure, 380)
    figure.update_layout(barmode="group", bargap=0.3)
    figure.update_xaxes(type="category", title_text="the central controller acts every")
    figure.update_yaxes(title_text="control-caused shortfall [% of desired]", rangemode="tozero")
    return ReportFigure(
        "shortfall",
        "What a slow central controller costs",
        "Shortfall that control caused, in % of the desired energy. Random clusters: their mean, "
        "with a line from the least to the most.",
        figure,
    )
