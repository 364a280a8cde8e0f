"""The clusters of a plant: their energies, and where their inverters stand."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from agents.plan import RunPlan
from bus_schemas.tree import parent_of
from recordings.read.series import RunSeries
from results.report import style
from results.report.help import HelpBetween
from results.tables import Cell, Column, Table, key_column

_MOST_COLOURS = 5


def clusters_table(series: RunSeries, plan: RunPlan, found: HelpBetween) -> Table:
    """Return a line for each cluster: its energies, and the help that it got and gave."""
    hours = series.cycle_s / 3600.0
    known = series.known
    of_column = [name if series.noun == "cluster" else parent_of(name) for name in series.inverters]
    rows: list[tuple[Cell, ...]] = []
    for cluster in dict.fromkeys(of_column):
        columns = [at for at, name in enumerate(of_column) if name == cluster]
        available = float(np.nansum(series.mpp_kw[known][:, columns])) * hours
        delivered = float(np.nansum(series.power_kw[known][:, columns])) * hours
        got = sum((kwh for _, kwh in found.helpers(cluster)), 0.0)
        gave = sum((kwh for (one, _), kwh in found.given_kwh.items() if one == cluster), 0.0)
        inverters = len(plan.tree.leaves_below(cluster))
        share = 100.0 * (available - delivered) / available if available > 0.0 else None
        need = found.needs.get(cluster)
        lacking = need.lacking_kwh if need else 0.0
        rating_kw = plan.tree.rating_kw(cluster)
        rows.append(
            (cluster, inverters, rating_kw, available, delivered, share, lacking, got, gave)
        )
    columns_ = (
        key_column("cluster"),
        Column("inverters"),
        Column("rating", "kW", 0),
        Column("available", "kWh", 1),
        Column("delivered", "kWh", 1),
        Column("curtailed", "%", 1),
        Column("lacking", "kWh", 1),
        Column("help got", "kWh", 1),
        Column("help given", "kWh", 1),
    )
    note = "Lacking, got and given: among clusters. Inside a cluster its supervisor settles it."
    return Table("Clusters", columns_, rows, (note,))


def clusters_map(plan: RunPlan) -> style.ReportFigure | None:
    """Draw where the inverters of each cluster stand; None if the plan does not say."""
    if len(plan.site.positions_m) != len(plan.tree.leaves):
        return None
    places: dict[str, list[tuple[str, float, float]]] = {}
    for leaf, (east, north) in zip(plan.tree.leaves, plan.site.positions_m, strict=True):
        places.setdefault(parent_of(leaf), []).append((leaf, east, north))
    symbols = ("circle", "square", "diamond", "triangle-up", "cross")
    traces = [
        go.Scatter(
            x=[east for _, east, _ in members],
            y=[north for *_, north in members],
            mode="markers",
            name=style.plain(cluster or "plant"),
            text=[style.plain(leaf) for leaf, *_ in members],
            hovertemplate="%{text}<extra></extra>",
            marker={
                "size": 11 if len(plan.tree.leaves) < 200 else 6,
                "color": style.SCHEMES[number % _MOST_COLOURS],
                "symbol": symbols[number // _MOST_COLOURS % len(symbols)],
            },
        )
        for number, (cluster, members) in enumerate(places.items())
    ]
    figure = style.dress(go.Figure(traces), 460)
    figure.update_xaxes(title_text="east [m]")
    figure.update_yaxes(title_text="north [m]", scaleanchor="x")
    return style.ReportFigure(
        "clusters",
        "Clusters",
        "Where the inverters stand, by cluster. Point at one for its name.",
        figure,
    )
