"""A run as arrays, one row for each cycle: what metrics and figures are computed from.

A recording, agents in memory and the array model all give a `RunSeries`, so there is one code for
the figures of merit.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from math import inf, isnan, nan
from operator import attrgetter
from typing import Any, Final, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from agents.control.grid import desired_kw, ramped_kw, response_kw
from agents.control.share import usable_dispatch_kw
from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Dispatch, Message, Meter, Production
from bus_schemas.signals import COMMAND, DISPATCH, IMPP, METER, PRODUCTION, RESIDUAL, Port, Signal
from bus_schemas.tree import ROOT, parent_of
from recordings.read.order_history import OrderHistory
from recordings.read.reader import RunReader
from sim_plant.meters import Meters
from sim_plant.profile import PROFILE_NAME, load_profile
from sim_plant.without_help import powers_without_help_kw, settling_cycles

PLANT_SIGNALS: Final = (DISPATCH, METER, PRODUCTION)
_OF_NODES: Final[dict[Signal[Any], str]] = {IMPP: "impp_kw", RESIDUAL: "residual_kw"}
"""Where the powers of these signals are entered."""
"""What the figures of merit of a run follow from."""

_MOST_COLUMNS: Final = 100


@dataclass(frozen=True, eq=False)
class RunSeries:
    """T cycles of a plant of n inverters under one control scheme. All powers in kW.

    A row stands for the cycle of its number. What no message says is NaN. Arrays are never changed:
    what follows from them is worked out once.

    label: What to call it in a table or a legend, for instance the control scheme.
    inverters: Paths of the n inverters in the control tree (`c2/inv07`); in a large plant those of
        clusters, which stand for their inverters.
    commitment_kw, regulation_kw: What the operator wanted in each cycle, shape (T,): the power
        promised, and the regulation on top of it (0 throughout if there is none).
    dispatch_kw: The paper's P_desired, shape (T,): the sum of both, unless an order is in force.
    frequency_hz: The grid's frequency at the beginning of each cycle, shape (T,).
    desired_kw: What the plant was to give, shape (T,): the dispatch within the ramp limits, and
        `response_kw`, the ideal response of its droop; without either, the dispatch as it is.
    mpp_kw, power_kw, impp_kw, residual_kw, alpha: Of each inverter, shape (T, n): true maximum
        power, power that it delivered, IMPP, IMPP less share, and the curtailment level in [0, 1]
        that it applied.
    storage_power_kw, storage_energy_kwh: Of each of m storages, shape (T, m): what it gave,
        negative if it took it, and what was stored in it at the end of the cycle.
    unknown_kw: What real inverters that do not answer may give beside the delivered power, (T,).
    unlisted_kw: What the plant's own meter reads beyond the sum of its inverters, (T,).
    baseline_kw: `without_help_kw` of a plant whose columns are clusters, shape (T,).
    first_cycle: Cycle of the run that the first row stands for.
    of_agents: Figures of merit that only a run of agents in a study counts, by name.
    orders: The dispatches with which an order came into force, or its state changed.
    """

    label: str
    plan: RunPlan
    inverters: tuple[str, ...]
    commitment_kw: NDArray[np.float64]
    regulation_kw: NDArray[np.float64]
    dispatch_kw: NDArray[np.float64]
    mpp_kw: NDArray[np.float64]
    power_kw: NDArray[np.float64]
    impp_kw: NDArray[np.float64]
    residual_kw: NDArray[np.float64]
    alpha: NDArray[np.float64]
    storage_power_kw: NDArray[np.float64]
    storage_energy_kwh: NDArray[np.float64]
    unknown_kw: NDArray[np.float64]
    unlisted_kw: NDArray[np.float64]
    frequency_hz: NDArray[np.float64]
    desired_kw: NDArray[np.float64]
    response_kw: NDArray[np.float64]
    baseline_kw: NDArray[np.float64] | None = None
    first_cycle: int = 0
    of_agents: Mapping[str, float] = field(default_factory=dict)
    orders: tuple[Dispatch, ...] = ()

    @classmethod
    def of(
        cls,
        plan: RunPlan,
        label: str,
        values: Mapping[str, NDArray[np.float64]],
        clusters: tuple[str, ...] = (),
    ) -> RunSeries:
        """Return the series of a plan's run; `values` are the fields with a row for each cycle.

        Those that are not given are unknown. Without orders, commitment and regulation give the
        dispatch.
        """
        shape = values["mpp_kw"].shape
        unknown = np.full(shape[0], nan)
        arrays: dict[str, Any] = {
            **dict.fromkeys(("impp_kw", "residual_kw", "alpha"), np.broadcast_to(nan, shape)),
            **dict.fromkeys(("commitment_kw", "regulation_kw", "frequency_hz"), unknown),
            **dict.fromkeys(("unknown_kw", "unlisted_kw"), np.zeros(shape[0])),
            **dict.fromkeys(("storage_power_kw", "storage_energy_kwh"), np.zeros((shape[0], 0))),
            **values,
        }
        arrays.setdefault("dispatch_kw", arrays["commitment_kw"] + arrays["regulation_kw"])
        arrays |= desired_powers(plan, arrays["dispatch_kw"], arrays["frequency_hz"])
        return cls(label, plan, clusters or plan.tree.leaves, **arrays)

    @property
    def noun(self) -> str:
        return "inverter" if self.inverters == self.plan.tree.leaves else "cluster"

    @property
    def rating_kw(self) -> float:
        return self.plan.tree.rating_kw(ROOT)

    @property
    def cycle_s(self) -> float:
        return self.plan.timing.cycle_s

    @property
    def cycles(self) -> int:
        return len(self.mpp_kw)

    @property
    def start_time_ns(self) -> int:
        return self.plan.timing.sim_time_ns(self.first_cycle)

    @cached_property
    def available_kw(self) -> NDArray[np.float64]:
        """True maximum power of the plant at its meter, shape (T,)."""
        return self.meters.available_kw(self.mpp_kw)

    @cached_property
    def delivered_kw(self) -> NDArray[np.float64]:
        """Power of the plant at its meter, shape (T,)."""
        return self.meters.fed_in_kw(self.power_kw, self.storage_power_kw) + self.unlisted_kw

    @property
    def lost_kw(self) -> NDArray[np.float64]:
        """Losses between inverters and meter, shape (T,)."""
        gross_kw = self.power_kw.sum(axis=1) + self.storage_power_kw.sum(axis=1)
        return np.asarray(gross_kw - self.meters.fed_in_kw(self.power_kw, self.storage_power_kw))

    @property
    def meters(self) -> Meters:
        return Meters(self.plan, self.inverters)

    @cached_property
    def without_storage_kw(self) -> NDArray[np.float64]:
        """What the inverters alone gave the plant at its meter, shape (T,)."""
        if not self.storage_power_kw.size:
            return self.delivered_kw
        return self.meters.fed_in_kw(self.power_kw) + self.unlisted_kw

    @cached_property
    def shortfall_kw(self) -> NDArray[np.float64]:
        """Power that others had to give, max(0, desired - P), shape (T,)."""
        return np.maximum(self.desired_kw - self.delivered_kw, 0.0)

    @cached_property
    def without_help_kw(self) -> NDArray[np.float64]:
        """The baseline, shape (T,): the plant's power if each inverter were held to its share.

        Of the desired power, under the same sky. NaN where that is not known.
        """
        if self.baseline_kw is not None:
            return self.baseline_kw
        if self.inverters != self.plan.tree.leaves:
            return np.full(self.cycles, nan)
        return _without_help_kw(self.plan, self.mpp_kw, self.desired_kw)

    @cached_property
    def known(self) -> NDArray[np.bool_]:
        """Whether the recording has dispatch and production of each cycle, shape (T,)."""
        of_dispatch = self.dispatch_kw + self.commitment_kw + self.regulation_kw
        return np.isfinite(of_dispatch) & np.isfinite(self.available_kw + self.delivered_kw)

    @property
    def times(self) -> pd.DatetimeIndex:
        """Local time of the beginning of each cycle, length T."""
        timing = self.plan.timing
        first = pd.Timestamp(self.start_time_ns, tz="UTC").tz_convert(timing.timezone)
        return pd.date_range(first, periods=self.cycles, freq=pd.Timedelta(timing.cycle_ns))

    def between(self, first: int, end: int) -> RunSeries:
        """Return the rows from the first one on to before the end alone."""
        part = self._rows(first, end)
        lead = settling_cycles(self.plan)
        if not lead or self.baseline_kw is not None:
            return part
        # What inverters obey in the first rows depends on the rows before.
        begin = max(first - lead, 0)
        baseline_kw = self._rows(begin, end).without_help_kw[first - begin :]
        return replace(part, baseline_kw=baseline_kw)

    def _rows(self, first: int, end: int) -> RunSeries:
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        part: dict[str, Any] = {
            name: rows[first:end] for name, rows in values.items() if isinstance(rows, np.ndarray)
        }
        return replace(self, first_cycle=self.first_cycle + first, **part)


def _without_help_kw(
    plan: RunPlan, mpp_kw: NDArray[np.float64], desired_kw: NDArray[np.float64]
) -> NDArray[np.float64]:
    powers_kw = powers_without_help_kw(plan, mpp_kw, desired_kw, plan.control.actuator)
    return Meters(plan).fed_in_kw(powers_kw)


def desired_powers(
    plan: RunPlan, dispatch_kw: NDArray[np.float64], frequency_hz: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Return what the grid asks of a plant in each cycle, whatever its controllers know of it."""
    response = np.zeros(len(dispatch_kw))
    if not plan.grid.moves_target:
        return {"desired_kw": dispatch_kw, "response_kw": response}
    response[:] = [response_kw(hz, plan.grid_law) for hz in frequency_hz.tolist()]
    desired, reference_kw = np.full(len(dispatch_kw), nan), nan
    for cycle in np.flatnonzero(np.isfinite(dispatch_kw)).tolist():
        usable_kw = usable_dispatch_kw(float(dispatch_kw[cycle]), plan.tree.rating_kw(ROOT))
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
        leaves = plan.tree.leaves
        self._plan = plan
        self._clusters = tuple(clusters)
        self._column = {node: column for column, node in enumerate(clusters or leaves)}
        self._column_of_leaf = [
            self._column[parent_of(leaf) if clusters else leaf] for leaf in leaves
        ]
        self._values: dict[str, NDArray[np.float64]] = {}
        self._heard = defaultdict[Port[Message], NDArray[np.bool_]](
            lambda: np.zeros(plan.timing.cycles, bool)
        )
        self.orders = OrderHistory()
        self._entries: dict[Port[Message], Callable[[Any], None]] = {}
        self._cycles = 0

    @property
    def has_clusters(self) -> bool:
        return bool(self._clusters)

    @property
    def ports(self) -> frozenset[Port[Message]]:
        """What the figures of merit follow from."""
        return frozenset(signal.of(ROOT) for signal in PLANT_SIGNALS)

    def see(self, port: Port[Message], message: Message) -> None:
        """Take in a message; those that the series does not need are ignored."""
        if 0 <= message.cycle < self._plan.timing.cycles:
            enter = self._entries.get(port)
            if enter is None:
                enter = self._entries[port] = self._entry(port)
            enter(message)

    def _entry(self, port: Port[Message]) -> Callable[[Any], None]:
        """Return what enters the messages of a port: a day of a small plant has millions."""
        if port.node in self._column:
            if port.signal is COMMAND:
                return self._entry_of_node(port.node, "alpha", attrgetter("alpha"))
            if (name := _OF_NODES.get(port.signal)) is not None:
                return self._entry_of_node(port.node, name, attrgetter("power_kw"))
        return partial(self._enter_other, port)

    def _entry_of_node(
        self, node: str, name: str, value_of: Callable[[Message], float]
    ) -> Callable[[Message], None]:
        """Return what enters a number of an inverter, unless an earlier message gave one."""
        width, column = len(self._column), self._column[node]
        values = self._rows_of(name, width).reshape(-1).data.cast("B").cast("d")

        def enter(message: Message) -> None:
            place = message.cycle * width + column
            if isnan(values[place]):
                values[place] = value_of(message)

        return enter

    def _enter_other(self, port: Port[Message], message: Message) -> None:
        match message:
            case Dispatch():
                self._enter_of_plant(
                    port,
                    message.cycle,
                    commitment_kw=message.commitment_kw,
                    regulation_kw=message.regulation_kw,
                    dispatch_kw=message.power_kw,
                )
                self.orders.see(message)
            case Production():
                self._enter_production(port, message)
            case Meter(frequency_hz=float() as frequency_hz):
                self._enter_of_plant(port, message.cycle, frequency_hz=frequency_hz)

    def _enter_production(self, port: Port[Message], message: Production) -> None:
        self._cycles = max(self._cycles, message.cycle + 1)
        power_kw = self._row(message.inverter_power_kw)
        stored = self._of_storages(message)
        unlisted_kw = 0.0
        if self._plan.site.meter:
            listed_kw = Meters(self._plan, self._clusters).fed_in_kw(
                power_kw, stored["storage_power_kw"]
            )
            unlisted_kw = message.delivered_kw - float(listed_kw)
        self._enter_of_plant(
            port,
            message.cycle,
            mpp_kw=self._row(message.inverter_mpp_kw),
            power_kw=power_kw,
            unlisted_kw=unlisted_kw,
            unknown_kw=message.unknown_kw,
            **stored,
        )

    def _of_storages(self, message: Production) -> dict[str, NDArray[np.float64]]:
        """Return what a production lists of the storages; an external plant may list none."""
        count, found = len(self._plan.storages), {}
        for name in ("storage_power_kw", "storage_energy_kwh"):
            listed = getattr(message, name) or ()
            found[name] = np.array(listed) if len(listed) == count else np.full(count, nan)
        return found

    def _row(self, listed: Sequence[float]) -> NDArray[np.float64]:
        """Add up what a production lists of each inverter, by column."""
        leaves = self._column_of_leaf
        powers_kw = np.full(len(leaves), nan)  # An external plant may list too few or too many.
        powers_kw[: len(listed)] = listed[: len(leaves)]
        return np.bincount(leaves, powers_kw, len(self._column)).astype(np.float64, copy=False)

    def _rows_of(self, name: str, *shape: int) -> NDArray[np.float64]:
        if name not in self._values:
            self._values[name] = np.full((self._plan.timing.cycles, *shape), nan)
        return self._values[name]

    def _enter_of_plant(
        self, port: Port[Message], cycle: int, **said: float | NDArray[np.float64]
    ) -> None:
        """Enter what the plant says; what contradicts an earlier message makes it unknown."""
        is_new = not self._heard[port][cycle]
        self._heard[port][cycle] = True
        for name, value in said.items():
            rows = self._rows_of(name, *np.shape(value))
            if is_new:
                rows[cycle] = value
            elif not np.array_equal(rows[cycle], value, equal_nan=True):
                rows[cycle] = nan

    def series(self, label: str) -> RunSeries:
        """Return the cycles up to the last one that the plant completed."""
        nothing = InputError("expected a run with at least one complete cycle, got none")
        if not self._cycles:
            raise nothing
        values = {name: rows[: self._cycles] for name, rows in self._values.items()}
        series = RunSeries.of(self._plan, label, values, self._clusters)
        if not series.known.any():
            raise nothing
        orders = tuple(one for one in self.orders.changes() if one.order_source)
        return replace(series, orders=orders)


class Listener(Protocol):
    """Takes in messages of its ports while a series is read: a recording is walked through once."""

    @property
    def ports(self) -> Collection[Port[Message]]: ...

    def see(self, port: Port[Message], message: Message) -> None: ...


def series_of(
    reader: RunReader, most_inverters: int | None = None, also: Sequence[Listener] = ()
) -> RunSeries:
    """Read what a report shows of a recording: NaN stands for IMPP and alpha.

    In a plant of more inverters, clusters stand for them.
    """
    clusters = columns_of(reader.plan, most_inverters)
    ports = reader.ports(RESIDUAL, nodes=clusters or reader.plan.tree.leaves)
    return _read(reader, ports, clusters, also)


def plant_series_of(reader: RunReader, most_inverters: int | None = _MOST_COLUMNS) -> RunSeries:
    """Read what the figures of merit need of a recording: NaN stands for IMPP, residual, alpha.

    In a plant of more inverters, clusters stand for them: a day is to fit into memory.
    """
    return _read(reader, frozenset(), columns_of(reader.plan, most_inverters))


def columns_of(plan: RunPlan, most_inverters: int | None = _MOST_COLUMNS) -> tuple[str, ...]:
    """Return the clusters that stand for the inverters; none if there are few enough."""
    leaves = plan.tree.leaves
    if most_inverters is None or len(leaves) <= most_inverters:
        return ()
    return tuple(dict.fromkeys(map(parent_of, leaves)))


def _read(
    reader: RunReader,
    ports: frozenset[Port[Message]],
    clusters: tuple[str, ...],
    also: Sequence[Listener] = (),
) -> RunSeries:
    collector = SeriesCollector(reader.plan, clusters)
    own = reader.ports(*PLANT_SIGNALS) | ports
    takers = {port: [collector.see] for port in own}
    for one in also:
        for port in one.ports:
            takers.setdefault(port, []).append(one.see)
    for port, message in reader.on(takers):
        for see in takers[port]:
            see(port, message)
    return collected(collector, reader)


def collected(collector: SeriesCollector, reader: RunReader) -> RunSeries:
    """Return the series of a recording all of whose messages a collector has seen."""
    try:
        series = collector.series(reader.plan.run_id)
    except InputError as error:
        raise InputError(f"{reader.path}: {error}") from None
    return _with_baseline(series, reader) if collector.has_clusters else series


def _with_baseline(series: RunSeries, reader: RunReader) -> RunSeries:
    """Add the baseline of a large plant, whose inverters are in its profile alone."""
    plan, path = reader.plan, reader.path.with_name(PROFILE_NAME)
    if not path.exists():
        return series
    mpp_kw = load_profile(path, plan.timing.cycles, len(plan.tree.leaves)).mpp_kw[: series.cycles]
    return replace(series, baseline_kw=_without_help_kw(plan, mpp_kw, series.desired_kw))
