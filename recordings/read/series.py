"""A run as arrays, one row for each cycle: what metrics and figures are computed from.

A recording, agents in memory and the array model all give a `RunSeries`, so there is one code for
the figures of merit.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, isnan, nan
from pathlib import Path
from typing import Any, Final, Literal, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from agents.control.grid import NO_GRID, GridLaw, desired_kw, net_kw, ramped_kw, response_kw
from agents.control.share import usable_dispatch_kw
from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Command, Dispatch, Impp, Message, Meter, Production, Residual
from bus_schemas.signals import COMMAND, DISPATCH, IMPP, METER, PRODUCTION, RESIDUAL, Port
from bus_schemas.tree import ROOT, parent_of
from recordings.read.reader import RunReader
from sim_plant.orders import OrderInForce

_MOST_APART: Final = 1000
"""A series has at least one cycle of so many; the rest would be gaps alone."""

_MOST_COLUMNS: Final = 100

_OF_DISPATCH: Final = {
    "commitment_kw": "commitment_kw",
    "regulation_kw": "regulation_kw",
    "dispatch_kw": "power_kw",
}
"""Fields of a `RunSeries`, and those of the dispatch that they come from."""

_OF_PLANT: Final = (*_OF_DISPATCH, "unknown_kw", "unlisted_kw", "frequency_hz")
_OF_INVERTERS: Final = ("mpp_kw", "power_kw", "impp_kw", "residual_kw", "alpha")
"""Fields of a `RunSeries` with a row for each cycle, and those that have columns too."""


@dataclass(frozen=True, slots=True, eq=False)
class SeriesPlant:
    """The plant of a series, and the time of its cycles.

    inverters, rating_kw: Paths of the n inverters in the control tree (`c2/inv07`), and their AC
        ratings, shape (n,).
    timezone: Local time of the plant, an IANA name.
    start_time_ns: Simulated time of the first cycle, ns since 1970-01-01 UTC.
    regulation_capacity_kw: Power that a regulation signal of +1 stands for; 0 if there is no
        regulation.
    ramp_limit_percent_per_min: Ramp limit in % of the plant's rating per minute, if a grid code
        sets one.
    interval_cycles: Length of an interval for which the commitment is offered; 0: it is given.
    grid: What the grid asks of the plant, and what is lost up to its meter.
    planned_cycles: How many cycles the run was to have; 0: as many as the series has.
    noun: What the n columns are: in a large plant clusters may stand for their inverters.
    """

    inverters: tuple[str, ...]
    rating_kw: NDArray[np.float64]
    timezone: str
    start_time_ns: int
    cycle_s: float
    regulation_capacity_kw: float = 0.0
    ramp_limit_percent_per_min: float | None = None
    interval_cycles: int = 0
    grid: GridLaw = NO_GRID
    planned_cycles: int = 0
    noun: Literal["inverter", "cluster"] = "inverter"

    @classmethod
    def of(cls, plan: RunPlan, clusters: Sequence[str] = ()) -> SeriesPlant:
        columns = tuple(clusters) or plan.tree.leaves
        return cls(
            inverters=columns,
            rating_kw=np.array([plan.tree.rating_kw(node) for node in columns]),
            timezone=plan.timing.timezone,
            start_time_ns=plan.timing.start_time_ns,
            cycle_s=plan.timing.cycle_ns / 1e9,
            regulation_capacity_kw=plan.site.regulation_capacity_kw,
            ramp_limit_percent_per_min=plan.site.ramp_limit_percent_per_min,
            interval_cycles=plan.control.offers.interval_cycles if plan.control.offers else 0,
            grid=plan.grid_law,
            planned_cycles=plan.timing.cycles,
            noun="cluster" if clusters else "inverter",
        )


@dataclass(frozen=True, slots=True, eq=False)
class RunSeries:
    """T cycles of a plant of n inverters under one control scheme. All powers in kW.

    A row stands for the cycle of its number. What no message says is NaN.

    label: What to call it in a table or a legend, for instance the control scheme.
    commitment_kw, regulation_kw: What the operator wanted in each cycle, shape (T,): the power
        promised, and the regulation on top of it (0 throughout if there is none).
    dispatch_kw: The paper's P_desired, shape (T,): the sum of both, unless an order is in force.
    frequency_hz: The grid's frequency at the beginning of each cycle, shape (T,).
    desired_kw: What the plant was to give, shape (T,): the dispatch within the ramp limits, and
        `response_kw`, the ideal response of its droop; without either, the dispatch as it is.
    mpp_kw, power_kw, impp_kw, residual_kw, alpha: Of each inverter, shape (T, n): true maximum
        power, power that it delivered, IMPP, IMPP less share, and the curtailment level in [0, 1]
        that it applied.
    unknown_kw: What real inverters that do not answer may give beside the delivered power, (T,).
    unlisted_kw: What the plant's own meter reads beyond the sum of its inverters, (T,).
    of_agents: Figures of merit that only a run of agents in a study counts, by name.
    orders: Orders, each with the cycle in which it came into force or in which its state changed.
    """

    label: str
    plant: SeriesPlant
    commitment_kw: NDArray[np.float64]
    regulation_kw: NDArray[np.float64]
    dispatch_kw: NDArray[np.float64]
    mpp_kw: NDArray[np.float64]
    power_kw: NDArray[np.float64]
    impp_kw: NDArray[np.float64]
    residual_kw: NDArray[np.float64]
    alpha: NDArray[np.float64]
    unknown_kw: NDArray[np.float64]
    unlisted_kw: NDArray[np.float64]
    frequency_hz: NDArray[np.float64]
    desired_kw: NDArray[np.float64]
    response_kw: NDArray[np.float64]
    of_agents: Mapping[str, float] = field(default_factory=dict)
    orders: tuple[tuple[int, OrderInForce], ...] = ()

    @classmethod
    def of(cls, plan: RunPlan, label: str, **values: NDArray[np.float64]) -> RunSeries:
        """Return the series of a plan's run; `values` are the fields with a row for each cycle.

        Those of inverters that are not given are unknown. Without orders, commitment and regulation
        give the dispatch.
        """
        if "dispatch_kw" not in values:
            values["dispatch_kw"] = values["commitment_kw"] + values["regulation_kw"]
        unknown = dict.fromkeys(_OF_INVERTERS, np.broadcast_to(nan, values["mpp_kw"].shape))
        for name in ("unknown_kw", "unlisted_kw"):
            unknown[name] = np.zeros(len(values["mpp_kw"]))
        unknown["frequency_hz"] = np.full(len(values["mpp_kw"]), nan)
        arrays: dict[str, Any] = unknown | values
        arrays |= _asked(plan, arrays["dispatch_kw"], arrays["frequency_hz"])
        return cls(label, SeriesPlant.of(plan), **arrays)

    @property
    def inverters(self) -> tuple[str, ...]:
        return self.plant.inverters

    @property
    def cycle_s(self) -> float:
        return self.plant.cycle_s

    @property
    def cycles(self) -> int:
        return len(self.mpp_kw)

    @property
    def available_kw(self) -> NDArray[np.float64]:
        """True maximum power of the plant at its meter, shape (T,)."""
        return self._net_kw(self.mpp_kw)

    @property
    def delivered_kw(self) -> NDArray[np.float64]:
        """Power of the plant at its meter, shape (T,)."""
        return self._net_kw(self.power_kw) + self.unlisted_kw

    @property
    def lost_kw(self) -> NDArray[np.float64]:
        """Losses between inverters and meter, shape (T,)."""
        return np.asarray(self.power_kw.sum(axis=1)) - self._net_kw(self.power_kw)

    def _net_kw(self, of_inverters_kw: NDArray[np.float64]) -> NDArray[np.float64]:
        return net_kw(np.asarray(of_inverters_kw.sum(axis=1)), self.plant.grid)

    @property
    def shortfall_kw(self) -> NDArray[np.float64]:
        """Power that others had to give, max(0, desired - P), shape (T,)."""
        return np.maximum(self.desired_kw - self.delivered_kw, 0.0)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether the recording has dispatch and production of each cycle, shape (T,)."""
        of_dispatch = self.dispatch_kw + self.commitment_kw + self.regulation_kw
        return np.isfinite(of_dispatch) & np.isfinite(self.available_kw + self.delivered_kw)

    @property
    def times(self) -> pd.DatetimeIndex:
        """Local time of the beginning of each cycle, length T."""
        first = pd.Timestamp(self.plant.start_time_ns, tz="UTC").tz_convert(self.plant.timezone)
        return pd.date_range(first, periods=self.cycles, freq=pd.Timedelta(seconds=self.cycle_s))

    def between(self, first: int, end: int) -> RunSeries:
        """Return the cycles from the first one on to before the end alone."""
        names = (*_OF_PLANT, *_OF_INVERTERS, "desired_kw", "response_kw")
        part = {name: getattr(self, name)[first:end] for name in names}
        begin_ns = self.plant.start_time_ns + round(first * self.cycle_s * 1e9)
        return replace(self, plant=replace(self.plant, start_time_ns=begin_ns), **part)


def _asked(
    plan: RunPlan, dispatch_kw: NDArray[np.float64], frequency_hz: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Return what the grid asks of a plant in each cycle, whatever its controllers know of it."""
    grid, rating_kw = plan.grid, plan.tree.rating_kw(ROOT)
    response = np.zeros(len(dispatch_kw))
    if not grid.moves_target:
        return {"desired_kw": dispatch_kw, "response_kw": response}
    response[:] = [response_kw(hz, plan.grid_law) for hz in frequency_hz.tolist()]
    desired, reference_kw = np.full(len(dispatch_kw), nan), nan
    for cycle in np.flatnonzero(np.isfinite(dispatch_kw)).tolist():
        usable_kw = usable_dispatch_kw(float(dispatch_kw[cycle]), rating_kw)
        reference_kw = ramped_kw(reference_kw, usable_kw, plan.grid_law)
        desired[cycle] = desired_kw(reference_kw, float(response[cycle]), inf, plan.grid_law)
    return {"desired_kw": desired, "response_kw": response}


class SeriesCollector:
    """Turns the messages of a run, live or from a recording, into a `RunSeries`.

    Of two messages of an inverter in a cycle the first one counts. Where two of dispatch or
    production contradict each other, another program has sent one of them: the cycle is unknown.
    """

    def __init__(self, plan: RunPlan, clusters: Sequence[str] = ()) -> None:
        """Take the plant's inverters as columns, or clusters that stand for them."""
        cycles, leaves = plan.timing.cycles, plan.tree.leaves
        self._plan = plan
        self._clusters = clusters
        self._column = {node: column for column, node in enumerate(clusters or leaves)}
        self._column_of_leaf = [
            self._column[parent_of(leaf) if clusters else leaf] for leaf in leaves
        ]
        self._of_plant = {name: np.full(cycles, nan) for name in _OF_PLANT}
        self._of_inverters = defaultdict[str, NDArray[np.float64]](
            lambda: np.full((cycles, len(self._column)), nan)
        )
        self._heard = defaultdict[Port[Message], NDArray[np.bool_]](lambda: np.zeros(cycles, bool))
        self._orders: list[tuple[int, OrderInForce]] = []
        self._cycles = 0

    def see(self, port: Port[Message], message: Message) -> None:
        """Take in a message; those that the series does not need are ignored."""
        cycle, plan = message.cycle, self._plan
        if not 0 <= cycle < plan.timing.cycles:
            return
        match message:
            case Dispatch():
                rows = {name: np.array(getattr(message, of)) for name, of in _OF_DISPATCH.items()}
                self._enter_of_plant(port, cycle, rows)
                self._enter_order(message)
            case Production():
                self._cycles = max(self._cycles, cycle + 1)
                made = {"mpp_kw": message.inverter_mpp_kw, "power_kw": message.inverter_power_kw}
                rows = {name: self._row(listed) for name, listed in made.items()}
                listed_kw = net_kw(float(rows["power_kw"].sum()), plan.grid_law)
                metered_kw = message.delivered_kw if plan.site.meter else listed_kw
                rows["unlisted_kw"] = np.array(metered_kw - listed_kw)
                rows["unknown_kw"] = np.array(message.unknown_kw)
                self._enter_of_plant(port, cycle, rows)
            case Meter() if message.frequency_hz is not None:
                self._enter_of_plant(port, cycle, {"frequency_hz": np.array(message.frequency_hz)})
            case Impp() if port.node in self._column:
                self._enter_of(port, "impp_kw", cycle, message.power_kw)
            case Residual() if port.node in self._column:
                self._enter_of(port, "residual_kw", cycle, message.power_kw)
            case Command() if port.node in self._column:
                self._enter_of(port, "alpha", cycle, message.alpha)

    def _enter_order(self, dispatch: Dispatch) -> None:
        order = OrderInForce.by(dispatch)
        last = self._orders[-1][1].what if self._orders else None
        if order is not None and order.what != last:
            self._orders.append((dispatch.cycle, order))

    def _row(self, listed: Sequence[float]) -> NDArray[np.float64]:
        """Add up what a production lists of each inverter, by column."""
        leaves = self._column_of_leaf
        powers_kw = np.full(len(leaves), nan)  # An external plant may list too few or too many.
        powers_kw[: len(listed)] = listed[: len(leaves)]
        return np.bincount(leaves, powers_kw, len(self._column)).astype(np.float64, copy=False)

    def _enter_of(self, port: Port[Message], name: str, cycle: int, value: float) -> None:
        """Enter a number, unless an earlier message gave one."""
        index = cycle, self._column[port.node]
        if isnan(self._of_inverters[name][index]):
            self._of_inverters[name][index] = value

    def _enter_of_plant(
        self, port: Port[Message], cycle: int, rows: dict[str, NDArray[np.float64]]
    ) -> None:
        """Enter what the plant says; what contradicts an earlier message makes it unknown."""
        is_new = not self._heard[port][cycle]
        self._heard[port][cycle] = True
        for name, row in rows.items():
            values = self._of_plant[name] if name in _OF_PLANT else self._of_inverters[name]
            if is_new:
                values[cycle] = row
            elif not np.array_equal(values[cycle], row, equal_nan=True):
                values[cycle] = nan

    def series(self, label: str) -> RunSeries:
        """Return the cycles up to the last one that the plant completed."""
        if not self._cycles:
            raise InputError("expected a run with at least one complete cycle, got none")
        columns = self._of_plant | self._of_inverters
        values = {name: column[: self._cycles] for name, column in columns.items()}
        series = RunSeries.of(self._plan, label, **values)
        plant, orders = SeriesPlant.of(self._plan, self._clusters), tuple(self._orders)
        series = replace(series, plant=plant, orders=orders)
        known = int(series.known.sum())
        if known * _MOST_APART <= series.cycles:
            raise InputError(
                f"expected dispatch and production of most of {series.cycles:,} cycles, got those "
                f"of {known:,}"
            )
        return series


def read_series(path: Path) -> RunSeries:
    with RunReader(path) as reader:
        return series_of(reader)


class Listener(Protocol):
    """Takes in messages of its ports while a series is read: a recording is walked through once."""

    @property
    def ports(self) -> Collection[Port[Message]]: ...

    def see(self, port: Port[Message], message: Message) -> None: ...


def series_of(
    reader: RunReader, most_inverters: int | None = None, also: Sequence[Listener] = ()
) -> RunSeries:
    """Read a recording; in a plant of more inverters, clusters stand for them."""
    nodes, clusters = reader.plan.tree.leaves, _clusters(reader.plan, most_inverters)
    signals = (IMPP, RESIDUAL) if clusters else (IMPP, RESIDUAL, COMMAND)
    ports: set[Port[Message]] = {
        signal.of(node) for signal in signals for node in clusters or nodes
    }
    return _read(reader, ports, clusters, also)


def read_plant_series(path: Path) -> RunSeries:
    with RunReader(path) as reader:
        return plant_series_of(reader)


def plant_series_of(reader: RunReader, most_inverters: int | None = _MOST_COLUMNS) -> RunSeries:
    """Read what the figures of merit need of a recording: NaN stands for IMPP, residual, alpha.

    In a plant of more inverters, clusters stand for them: a day is to fit into memory.
    """
    return _read(reader, set(), _clusters(reader.plan, most_inverters))


def _clusters(plan: RunPlan, most_inverters: int | None) -> tuple[str, ...]:
    """Return the clusters that stand for the inverters; none if there are few enough."""
    leaves = plan.tree.leaves
    if most_inverters is None or len(leaves) <= most_inverters:
        return ()
    return tuple(dict.fromkeys(map(parent_of, leaves)))


def _read(
    reader: RunReader,
    ports: set[Port[Message]],
    clusters: tuple[str, ...],
    also: Sequence[Listener] = (),
) -> RunSeries:
    collector = SeriesCollector(reader.plan, clusters)
    own = reader.ports(DISPATCH, METER, PRODUCTION) | ports
    for port, message in reader.on(own.union(*(one.ports for one in also))):
        if port in own:
            collector.see(port, message)
        for one in also:
            if port in one.ports:
                one.see(port, message)
    try:
        return collector.series(reader.plan.run_id)
    except InputError as error:
        raise InputError(f"{reader.path}: {error}") from None
