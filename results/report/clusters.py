"""The clusters of a plant: their energies, and the help among them."""

from __future__ import annotations

import numpy as np

from agents.plan import RunPlan
from bus_schemas.tree import parent_of
from recordings.read.series import RunSeries
from results.report.help import HelpBetween
from results.tables import Cell, Column, Table, key_column


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
