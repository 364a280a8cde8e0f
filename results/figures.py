"""The figures of merit of a run: the one list of them, and how they are computed.

docs/metrics.md has their definitions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Flag, auto
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agents.control.offers import MISSED_SHARE, firm_share
from recordings.read.series import RunSeries
from results.battery import smallest_battery
from results.regulation import regulation_figures
from results.tables import Cell, Column, Number, Table, key_column

Figures: TypeAlias = dict[str, float | None]
"""Figures of merit by name, all of `FIGURES`; None where a run does not define one."""

_ROUNDING: Final = 1e-9
_RAMP_TOLERANCE: Final = 0.01


class Shown(Flag):
    """Where tables show a figure, its group, and whether more of it is better. JSON has all."""

    SUMMARY = auto()
    """At the end of a run, and on the live page."""
    REPORT = auto()
    COMPARE = auto()
    """In `compare` of one case."""
    AGENTS = auto()
    """What the agents had to do; only runs of agents have it."""
    REGULATION = auto()
    """How a regulation signal was followed."""
    MORE_IS_BETTER = auto()


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure of merit: its name in JSON and on the command line, and how tables show it."""

    name: str
    title: str
    unit: str
    decimals: int
    shown: Shown

    @property
    def is_more_better(self) -> bool:
        """Whether of two runs the one with more of it is better."""
        return Shown.MORE_IS_BETTER in self.shown

    @property
    def heading(self) -> str:
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    @property
    def column(self) -> Column:
        return Column(self.title, self.unit, self.decimals, name=self.name)


_NOWHERE: Final = Shown(0)
_R: Final = Shown.REPORT
_C: Final = Shown.COMPARE
_SR: Final = Shown.SUMMARY | Shown.REPORT
_SRC: Final = _SR | Shown.COMPARE
_AC: Final = Shown.AGENTS | Shown.COMPARE
_MORE: Final = Shown.MORE_IS_BETTER
_G: Final = Shown.REGULATION | Shown.REPORT
_GC: Final = _G | Shown.COMPARE | _MORE
_GSC: Final = _GC | Shown.SUMMARY

FIGURES: Final = {
    row[0]: Figure(*row)
    for row in (
        ("cycles", "Cycles covered", "", 0, _R),
        ("planned-cycles", "Cycles planned", "", 0, _R),
        ("dispatched-energy", "Dispatched energy", "kWh", 1, _SR),
        ("available-energy", "Available energy", "kWh", 1, _SR),
        ("delivered-energy", "Delivered energy", "kWh", 1, _SR),
        ("unknown-energy", "Energy of lost inverters", "kWh", 1, _SR),
        ("satisfied", "Satisfied commitment", "%", 3, _SRC | _MORE),
        ("shortfall-energy", "Shortfall", "kWh", 2, _SRC),
        ("unavoidable-energy", "Shortfall, unavoidable", "kWh", 2, _SR),
        ("control-caused-energy", "Shortfall, control-caused", "kWh", 2, _SR),
        ("without-help-energy", "Control-caused, without help", "kWh", 2, _SR),
        ("over-delivered-energy", "Over-delivery", "kWh", 2, _SR),
        ("metered-control-caused-energy", "Control-caused, by the meter", "kWh", 2, _SR),
        ("metered-over-delivered-energy", "Over-delivery, by the meter", "kWh", 2, _SR),
        ("shortfall", "Shortfall", "% of dispatch", 3, _NOWHERE),
        ("unavoidable", "Unavoidable", "% of dispatch", 3, _C),
        ("control-caused", "Control-caused", "% of dispatch", 3, _C),
        ("without-help", "Control-caused, without help", "% of dispatch", 3, _NOWHERE),
        ("over-delivered", "Over-delivered", "% of dispatch", 3, _C),
        ("metered-control-caused", "Control-caused, by the meter", "% of dispatch", 3, _C),
        ("metered-over-delivered", "Over-delivered, by the meter", "% of dispatch", 3, _C),
        ("rmse", "Tracking RMSE", "kW", 2, _SRC),
        ("mae", "Tracking MAE", "kW", 2, _R),
        ("mileage", "Mileage per hour", "kW/h", 0, _SRC),
        ("battery-power", "Battery needed", "kW", 1, _SR),
        ("battery-energy", "Battery needed, capacity", "kWh", 2, _SRC),
        ("battery-cycles", "Battery needed, full cycles", "", 1, _R),
        ("battery-mileage", "Battery needed, mileage per hour", "kW/h", 0, _R),
        ("control-battery-power", "Battery for control-caused", "kW", 1, _R),
        ("control-battery-energy", "Battery for control-caused, capacity", "kWh", 2, _R),
        ("without-help-battery-power", "Battery needed without help", "kW", 1, _SR),
        ("without-help-battery-energy", "Battery needed without help, capacity", "kWh", 2, _SR),
        ("without-help-battery-cycles", "Battery needed without help, full cycles", "", 1, _R),
        (
            "without-help-battery-mileage",
            "Battery needed without help, mileage per hour",
            "kW/h",
            0,
            _R,
        ),
        ("without-storage-energy", "Shortfall without storage", "kWh", 2, _SRC),
        ("storage-out-energy", "Given by storage", "kWh", 1, _SRC),
        ("storage-in-energy", "Taken by storage", "kWh", 1, _SR),
        ("storage-cycles", "Full cycles of storage", "", 2, _SRC),
        ("storage-mileage", "Mileage of storage per hour", "kW/h", 0, _R | _C),
        ("storage-lowest", "Lowest state of storage", "%", 1, _SRC),
        ("storage-highest", "Highest state of storage", "%", 1, _R),
        ("curtailed-energy", "Curtailed energy", "kWh", 1, _SRC),
        ("curtailed", "Curtailed", "% of available", 1, _R | _C),
        ("ancillary-potential", "Ancillary potential", "kWh", 1, _R),
        ("rise", "Largest rise", "kW/min", 1, _R),
        ("fall", "Largest fall", "kW/min", 1, _R),
        ("ramp", "Largest ramp", "kW/min", 0, Shown.SUMMARY),
        ("ramp-limit", "Ramp limit", "kW/min", 0, _R),
        ("above-ramp-limit", "Minutes above the ramp limit", "%", 2, _SR),
        ("ramp-control", "Minutes beyond the grid's ramps, by control", "%", 2, _SRC),
        ("ramp-clouds", "Minutes beyond the grid's ramps, by clouds", "%", 2, _SRC),
        ("loss-energy", "Losses up to the meter", "kWh", 1, _SR),
        ("outside-help", "Help from outside the cluster", "%", 1, _AC),
        ("outside-help-able", "Help from outside, plant able", "%", 1, _AC),
        ("missed-inputs", "Inputs missed", "", 0, _AC),
        ("reverted", "Reverted", "%", 2, _AC),
        ("intervals", "Intervals offered", "", 0, _R),
        ("kept-intervals", "Intervals with enough power", "%", 1, _SRC | _MORE),
        ("firm-energy", "Firm energy", "kWh", 1, _R),
        ("promised", "Promised of firm energy", "%", 1, _SRC | _MORE),
        ("capacity", "Regulation capacity", "kW", 0, _G),
        ("offered", "Regulation offered", "h", 2, _G),
        ("signal-mileage", "Mileage of the signal", "1/h", 2, _G),
        ("regd-strict", "Requests fulfilled to 0.1 %", "%", 2, _GSC),
        ("regd", "Requests fulfilled to 1 %", "%", 2, _GSC),
        ("regd-feasible-strict", "Feasible requests fulfilled to 0.1 %", "%", 2, _GC),
        ("regd-feasible", "Feasible requests fulfilled to 1 %", "%", 2, _GC),
        ("accuracy", "Accuracy", "", 3, _GC),
        ("delay", "Delay", "", 3, _GC),
        ("precision", "Precision", "", 3, _GC),
        ("score", "PJM performance score", "", 3, _GSC),
    )
}
"""All figures of merit by name, in the order in which tables show them."""


def shown_in(where: Shown, group: Shown | None = None) -> tuple[Figure, ...]:
    """Return the figures that are shown somewhere: all, or those of one group.

    `Shown(0)` is the group of all that is neither of the agents nor of regulation.
    """
    groups = Shown.AGENTS | Shown.REGULATION
    return tuple(
        figure
        for figure in FIGURES.values()
        if where & figure.shown and (group is None or figure.shown & groups == group)
    )


def runs_as_columns(
    title: str,
    runs: Sequence[tuple[str, Figures]],
    figures: Sequence[Figure],
    notes: tuple[str, ...] = (),
    *,
    difference: bool = False,
) -> Table:
    """Return a table with a row for each figure and a column for each labelled run.

    Figures that no run defines are left out. With `difference`, a last column has the second of
    two runs less the first.
    """
    labels = [label for label, _ in runs]
    rows: list[tuple[Cell, ...]] = []
    for figure in figures:
        values = [merits[figure.name] for _, merits in runs]
        if all(value is None for value in values):
            continue
        if difference:
            first, second = values
            values.append(None if first is None or second is None else second - first)
        cells = (Number(value, figure.decimals) for value in values)
        rows.append((figure.title, figure.unit, *cells))
    if difference:
        labels.append("difference")
    columns = (key_column("", "figure"), key_column("", "unit"), *map(Column, labels))
    return Table(title, columns, tuple(rows), notes)


def run_figures(series: RunSeries) -> Figures:
    """Compute the figures of merit of a run.

    Cycles whose dispatch or production is missing do not count. A ramp that begins or ends in one
    is left out, and so is a window of PJM's score that holds one.

    Raises ValueError: The run has no cycle with both.
    """
    known = series.known
    if not known.any():
        raise ValueError("run: expected a cycle with dispatch and production, got none")
    dispatch_kw, available_kw = series.desired_kw[known], series.available_kw[known]
    delivered_kw = series.delivered_kw[known]
    # From one known cycle to the next: what happened between others is not known.
    changes_kw = np.diff(np.where(known, series.shortfall_kw, np.nan))
    hours = series.cycle_s / 3600.0
    error_kw = delivered_kw - dispatch_kw
    headroom_kw = np.maximum(available_kw - series.without_storage_kw[known], 0.0)
    potential_kw = np.maximum(available_kw - series.commitment_kw[known], 0.0)
    return {
        **dict.fromkeys(FIGURES),
        "cycles": int(known.sum()),
        "planned-cycles": series.plan.timing.cycles,
        **energy_figures(dispatch_kw, available_kw, delivered_kw, series.cycle_s),
        **_metered_figures(series),
        **_baseline_figures(series),
        **_battery_figures(series),
        **_storage_figures(series),
        "unknown-energy": float(np.nansum(series.unknown_kw[known])) * hours or None,
        "rmse": float(np.sqrt(np.mean(error_kw**2))),
        "mae": float(np.mean(np.abs(error_kw))),
        "mileage": float(np.nansum(np.abs(changes_kw))) / (int(known.sum()) * hours),
        "curtailed-energy": float(headroom_kw.sum()) * hours,
        "curtailed": _share(headroom_kw.sum(), available_kw.sum()),
        "ancillary-potential": float(potential_kw.sum()) * hours,
        **_ramp_figures(series),
        **_grid_ramp_figures(series),
        "loss-energy": float(series.lost_kw[known].sum()) * hours or None,
        **_help_figures(series),
        **_offer_figures(series),
        **series.of_agents,
        **regulation_figures(series),
    }


def _share(part: float, whole: float) -> float | None:
    """Return a part in %, None of nothing."""
    return 100.0 * float(part) / float(whole) if whole > 0.0 else None


def energy_figures(
    dispatch_kw: ArrayLike, available_kw: ArrayLike, delivered_kw: ArrayLike, cycle_s: float
) -> Figures:
    """Compute how well a plant kept its commitment from its power in each cycle, shape (T,).

    The shortfall is sum max(0, dispatch - delivered) dt. Unavoidable is the part of it that no
    controller could have met, sum max(0, dispatch - available) dt, unless storages gave it;
    control-caused the rest. Shares
    are in % of the dispatched energy, None where nothing was dispatched.
    """
    dispatch, available, delivered = map(np.asarray, (dispatch_kw, available_kw, delivered_kw))
    shortfall = np.maximum(dispatch - delivered, 0.0)
    # Storages may give what the sky denied.
    unavoidable = np.minimum(np.maximum(dispatch - available, 0.0), shortfall)
    missed_kw = {
        "shortfall": shortfall,
        "unavoidable": unavoidable,
        "control-caused": shortfall - unavoidable,
        "over-delivered": np.maximum(delivered - dispatch, 0.0),
    }
    powers_kw = {
        "dispatched": dispatch,
        "available": available,
        "delivered": delivered,
        **missed_kw,
    }
    kwh = {name: float(kw.sum()) * cycle_s / 3600.0 for name, kw in powers_kw.items()}
    dispatched_kwh = kwh["dispatched"]
    figures: Figures = {f"{name}-energy": energy_kwh for name, energy_kwh in kwh.items()}
    if dispatched_kwh > 0.0:
        figures |= {name: 100.0 * kwh[name] / dispatched_kwh for name in missed_kw}
        figures["satisfied"] = 100.0 - 100.0 * kwh["shortfall"] / dispatched_kwh
    return figures


def _metered_figures(series: RunSeries) -> Figures:
    """Compute the same from what a meter reads that is known to be wrong: what is paid."""
    percent = series.plan.grid.meter_error_percent
    if percent == 0.0:
        return {}
    known, reads = series.known, 1.0 + percent / 100.0
    read_kw = reads * series.available_kw[known], reads * series.delivered_kw[known]
    found = energy_figures(series.desired_kw[known], *read_kw, series.cycle_s)
    names = ("control-caused", "over-delivered")
    parts = [f"{name}{ending}" for name in names for ending in ("-energy", "")]
    return {f"metered-{part}": found.get(part) for part in parts}


def _baseline_figures(series: RunSeries) -> Figures:
    """Compute what the same plant would have missed, although it had the power, without help."""
    known = series.known
    if not np.isfinite(series.without_help_kw[known]).all():
        return {}
    powers_kw = series.desired_kw[known], series.available_kw[known], series.without_help_kw[known]
    found = energy_figures(*powers_kw, series.cycle_s)
    return {
        "without-help-energy": found["control-caused-energy"],
        "without-help": found.get("control-caused"),
    }


def _battery_figures(series: RunSeries) -> Figures:
    """Compute the batteries that would have given what was missed, with help and without it."""
    hours = int(series.known.sum()) * series.cycle_s / 3600.0
    denied_kw = np.maximum(series.desired_kw - series.available_kw, 0.0)
    given_kw = {"": series.delivered_kw, "without-help-": series.without_help_kw}
    missing_kw = {name: np.maximum(series.desired_kw - kw, 0.0) for name, kw in given_kw.items()}
    given_kw["control-"] = series.delivered_kw
    missing_kw["control-"] = np.maximum(missing_kw[""] - denied_kw, 0.0)
    found: Figures = {}
    for name, kw in given_kw.items():
        if np.isfinite(kw[series.known]).all():
            of_inverters_kw = kw if name == "without-help-" else series.without_storage_kw
            spare_kw = np.maximum(series.available_kw - of_inverters_kw, 0.0)
            battery = smallest_battery(missing_kw[name], spare_kw, series.cycle_s)
            found[f"{name}battery-power"] = battery.power_kw
            found[f"{name}battery-energy"] = battery.energy_kwh
            found[f"{name}battery-cycles"] = battery.cycles
            found[f"{name}battery-mileage"] = battery.mileage_kw / hours
    return {name: value for name, value in found.items() if name in FIGURES}


def _storage_figures(series: RunSeries) -> Figures:
    """Compute what the storages did, at the bus bar; states are in % of their capacity."""
    storages, known = series.plan.storages, series.known
    power_kw, energy_kwh = series.storage_power_kw[known], series.storage_energy_kwh[known]
    if not storages or not power_kw.size:
        return {}
    hours = series.cycle_s / 3600.0
    capacity_kwh = np.array([one.capacity_kwh for one in storages])
    given_kwh = np.maximum(power_kw, 0.0).sum(axis=0) * hours
    stored_kwh = given_kwh / [one.discharge_efficiency for one in storages]
    changes_kw = np.abs(np.diff(power_kw, axis=0)).sum()
    missing_kw = np.maximum(series.desired_kw - series.without_storage_kw, 0.0)[known]
    states = 100.0 * energy_kwh / capacity_kwh
    return {
        "without-storage-energy": float(missing_kw.sum()) * hours,
        "storage-out-energy": float(given_kwh.sum()),
        "storage-in-energy": float(np.maximum(-power_kw, 0.0).sum()) * hours,
        "storage-cycles": float(stored_kwh.sum() / capacity_kwh.sum()),
        "storage-mileage": float(changes_kw) / (len(power_kw) * hours),
        "storage-lowest": float(states.min()),
        "storage-highest": float(states.max()),
    }


def _offer_figures(series: RunSeries) -> Figures:
    """Compute how often there was enough power for what was offered, and what could have been.

    An interval has enough if at most `MISSED_SHARE` of what the schedule asked for, commitment and
    regulation, was more than was available or, with storages, delivered, which is also how the
    plant judges its offers. Firm energy is the most that could have been promised so without
    storages, of the same shape and without regulation, in hindsight. An interval that is not known
    as a whole, or in which nothing is promised, is left out, and so is the first: nobody has
    offered it.
    """
    if (offers := series.plan.offer_law) is None:
        return {}
    length = offers.interval_cycles
    intervals = kept = 0
    promised_kw = firm_kw = 0.0
    for begin in range(length, series.cycles - length + 1, length):
        cycles = slice(begin, begin + length)
        commitment_kw, available_kw = series.commitment_kw[cycles], series.available_kw[cycles]
        there_kw = np.maximum(available_kw, series.delivered_kw[cycles])
        if not series.known[cycles].all() or not (commitment_kw > 0.0).all():
            continue
        intervals += 1
        scheduled_kw = commitment_kw + series.regulation_kw[cycles]
        missing_kw = np.maximum(scheduled_kw - there_kw, 0.0).sum()
        kept += bool(missing_kw <= MISSED_SHARE * scheduled_kw.sum())
        promised_kw += float(commitment_kw.sum())
        firm_kw += float(commitment_kw.sum()) * firm_share(available_kw / commitment_kw)
    if not intervals:
        return {}
    return {
        "intervals": intervals,
        "kept-intervals": 100.0 * kept / intervals,
        "firm-energy": firm_kw * series.cycle_s / 3600.0,
        "promised": _share(promised_kw, firm_kw),
    }


def _ramp_figures(series: RunSeries) -> Figures:
    """Compute the ramps of delivered power.

    A ramp is the change over a minute, P(t + 60 s) - P(t), from every cycle on. Where 60 s is no
    multiple of the cycle, it is the change over the nearest number of cycles, at least one, as a
    rate per minute. A minute is above the limit, in % of the rating per minute, if a larger ramp
    began in it. A run of a minute or less has no ramp.
    """
    span = _cycles_of_a_minute(series)
    ramps_kw = (series.delivered_kw[span:] - series.delivered_kw[:-span]) * (
        60.0 / (span * series.cycle_s)
    )
    # By minute the largest ramp; minutes without any known one do not count.
    largest_kw = np.fmax.reduceat(np.abs(ramps_kw), np.arange(0, len(ramps_kw), span))
    largest_kw = largest_kw[np.isfinite(largest_kw)]
    if not len(largest_kw):
        return {}
    figures: Figures = {
        "rise": max(0.0, float(np.nanmax(ramps_kw))),
        "fall": max(0.0, -float(np.nanmin(ramps_kw))),
        "ramp": float(largest_kw.max()),
    }
    limit_percent = series.plan.site.ramp_limit_percent_per_min
    if limit_percent is not None:
        figures["ramp-limit"] = limit_kw = series.rating_kw * limit_percent / 100.0
        # A plant that ramps exactly as fast as it may is not too fast by a rounding error.
        too_fast = largest_kw > limit_kw + _ROUNDING * series.rating_kw
        figures["above-ramp-limit"] = 100.0 * float(too_fast.mean())
    return figures


def _cycles_of_a_minute(series: RunSeries) -> int:
    return max(1, round(60.0 / series.cycle_s))


def _grid_ramp_figures(series: RunSeries) -> Figures:
    """Compute the minutes in which the plant was faster than the grid lets its target be, in %.

    A ramp is the change over a minute, beyond the limit by more than 1 % of the rating. Frequency
    response is no ramp. What the sky denied of the desired power is added to what was delivered:
    a ramp that is then within the limits is due to clouds, another one to control.
    """
    law, span = series.plan.grid_law, _cycles_of_a_minute(series)
    if min(law.ramp_up_kw, law.ramp_down_kw) == np.inf or series.cycles <= span:
        return {}

    def by_minute(values: NDArray[np.bool_]) -> NDArray[np.bool_]:
        return np.logical_or.reduceat(values, np.arange(0, len(values), span))

    def beyond(power_kw: NDArray[np.float64]) -> NDArray[np.bool_]:
        ramp_kw = power_kw[span:] - power_kw[:-span]
        tolerance_kw = _RAMP_TOLERANCE * series.rating_kw
        rises = ramp_kw > law.ramp_up_kw * span + tolerance_kw
        falls = ramp_kw < -law.ramp_down_kw * span - tolerance_kw
        return by_minute(rises | falls)

    own_kw = np.where(series.known, series.delivered_kw - series.response_kw, np.nan)
    denied_kw = np.maximum(series.desired_kw - series.available_kw, 0.0)
    counts = by_minute(np.isfinite(own_kw[span:] - own_kw[:-span]))
    if not counts.any():
        return {}
    by_control = beyond(own_kw + denied_kw)
    by_clouds = beyond(own_kw) & ~by_control
    return {
        "ramp-control": 100.0 * float(by_control[counts].mean()),
        "ramp-clouds": 100.0 * float(by_clouds[counts].mean()),
    }


def _help_figures(series: RunSeries) -> Figures:
    """Compute how often inverters in need got help from outside their own cluster, in %.

    A cycle is needy if any residual, IMPP less share (paper, eq. 4), is negative. It is settled
    outside if the residuals of any cluster add up to less than zero: its supervisor must ask its
    parent. A cluster is all that is below one child of the central controller: what a tier in
    between has settled has not reached the top. `able` counts only cycles in which the sum of all
    residuals is not negative: in the others some cluster must lack power, whatever it is.
    """
    residual_kw = series.residual_kw[np.isfinite(series.residual_kw).all(axis=1)]
    cluster_of = np.array([path.partition("/")[0] for path in series.inverters])
    clusters_kw = [residual_kw[:, cluster_of == name].sum(axis=1) for name in set(cluster_of)]
    needy = (residual_kw < 0.0).any(axis=1)
    outside = needy & (np.min(clusters_kw, axis=0) < 0.0)
    able = residual_kw.sum(axis=1) >= 0.0
    shares = {"outside-help": needy, "outside-help-able": needy & able}
    return {
        name: 100.0 * float(outside[cycles].mean())
        for name, cycles in shares.items()
        if cycles.any()
    }
