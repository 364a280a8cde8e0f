"""A run as arrays, one row for each cycle: what metrics and figures are computed from.

A recording, agents in memory and the array model all give a `RunSeries`, so there is one code for
the figures of merit.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Command, Dispatch, Impp, Message, Production, Residual
from bus_schemas.signals import COMMAND, DISPATCH, IMPP, PRODUCTION, RESIDUAL, Port, Signal
from recordings.read.reader import RunReader

_MOST_APART: Final = 1000
"""A series has at least one cycle of so many; the rest would be gaps alone."""

_OF_PLANT: Final = ("commitment_kw", "regulation_kw")
_OF_INVERTERS: Final = ("mpp_kw", "power_kw", "impp_kw", "residual_kw", "alpha")
"""Fields of a `RunSeries` with a row for each cycle, and those that have columns too."""


@dataclass(frozen=True, slots=True, eq=False)
class RunSeries:
    """T cycles of a plant of n inverters under one control scheme. All powers in kW.

    A row stands for the cycle of its number. What no message says is NaN.

    label: What to call it in a table or a legend, for instance the control scheme.
    inverters, rating_kw: Paths of the inverters in the control tree (`c2/inv07`), and their AC
        ratings, shape (n,).
    timezone: Local time of the plant, an IANA name.
    start_time_ns: Simulated time of the first cycle, ns since 1970-01-01 UTC.
    commitment_kw, regulation_kw: What the operator wanted in each cycle, shape (T,): the power
        promised, and the regulation on top of it (0 throughout if there is none).
    regulation_capacity_kw: Power that a regulation signal of +1 stands for; 0 if there is no
        regulation.
    mpp_kw, power_kw, impp_kw, residual_kw, alpha: Of each inverter, shape (T, n): true maximum
        power, power that it delivered, IMPP, IMPP less request, and the curtailment level in [0, 1]
        that it applied.
    ramp_limit_percent_per_min: Ramp limit in % of the plant's rating per minute, if a grid code
        sets one.
    """

    label: str
    inverters: tuple[str, ...]
    rating_kw: NDArray[np.float64]
    timezone: str
    start_time_ns: int
    cycle_s: float
    commitment_kw: NDArray[np.float64]
    regulation_kw: NDArray[np.float64]
    regulation_capacity_kw: float
    mpp_kw: NDArray[np.float64]
    power_kw: NDArray[np.float64]
    impp_kw: NDArray[np.float64]
    residual_kw: NDArray[np.float64]
    alpha: NDArray[np.float64]
    ramp_limit_percent_per_min: float | None = None

    @classmethod
    def of(cls, plan: RunPlan, label: str, **values: NDArray[np.float64]) -> RunSeries:
        """Return the series of a plan's run; `values` are the fields with a row for each cycle.

        Those of inverters that are not given are unknown.
        """
        leaves = plan.tree.leaves
        unknown = dict.fromkeys(_OF_INVERTERS, np.full_like(values["mpp_kw"], nan))
        return cls(
            label=label,
            inverters=leaves,
            rating_kw=np.array([plan.tree.rating_kw(leaf) for leaf in leaves]),
            timezone=plan.timezone,
            start_time_ns=plan.start_time_ns,
            cycle_s=plan.cycle_ns / 1e9,
            regulation_capacity_kw=plan.regulation_capacity_kw,
            ramp_limit_percent_per_min=plan.ramp_limit_percent_per_min,
            **(unknown | values),
        )

    @property
    def cycles(self) -> int:
        return len(self.mpp_kw)

    @property
    def desired_kw(self) -> NDArray[np.float64]:
        """Commitment plus regulation, the paper's P_desired, shape (T,)."""
        return self.commitment_kw + self.regulation_kw

    @property
    def possible_kw(self) -> NDArray[np.float64]:
        """True maximum power of the plant, shape (T,)."""
        return np.asarray(self.mpp_kw.sum(axis=1))

    @property
    def delivered_kw(self) -> NDArray[np.float64]:
        """Power of the plant, shape (T,)."""
        return np.asarray(self.power_kw.sum(axis=1))

    @property
    def support_kw(self) -> NDArray[np.float64]:
        """Power that others had to give, max(0, P_desired - P), shape (T,)."""
        return np.maximum(self.desired_kw - self.delivered_kw, 0.0)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether the recording has dispatch and production of each cycle, shape (T,)."""
        return np.isfinite(self.desired_kw) & np.isfinite(self.possible_kw + self.delivered_kw)

    @property
    def times(self) -> pd.DatetimeIndex:
        """Local time of the beginning of each cycle, length T."""
        first = pd.Timestamp(self.start_time_ns, tz="UTC").tz_convert(self.timezone)
        return pd.date_range(first, periods=self.cycles, freq=pd.Timedelta(seconds=self.cycle_s))

    def between(self, first: int, end: int) -> RunSeries:
        """Return the cycles from the first one on to before the end alone."""
        part = {name: getattr(self, name)[first:end] for name in (*_OF_PLANT, *_OF_INVERTERS)}
        begin_ns = self.start_time_ns + round(first * self.cycle_s * 1e9)
        return replace(self, start_time_ns=begin_ns, **part)


class _Values:
    """The numbers of one port: of the first message of each cycle."""

    def __init__(self) -> None:
        self._cycles, self._values = array("q"), array("d")

    def add(self, cycle: int, value: float) -> None:
        self._cycles.append(cycle)
        self._values.append(value)

    def by_cycle(self, cycles: int) -> NDArray[np.float64]:
        found = np.full(cycles, nan)
        cycle, value = np.array(self._cycles), np.array(self._values)
        kept = (cycle >= 0) & (cycle < cycles)
        # Later entries overwrite earlier ones: backwards, so that the first message counts.
        found[cycle[kept][::-1]] = value[kept][::-1]
        return found


class SeriesCollector:
    """Turns the messages of a run, live or from a recording, into a `RunSeries`."""

    def __init__(self, plan: RunPlan) -> None:
        self._plan = plan
        self._of_plant = {name: _Values() for name in _OF_PLANT}
        self._of_inverters = {name: [_Values() for _ in plan.tree.leaves] for name in _OF_INVERTERS}
        self._column = {leaf: column for column, leaf in enumerate(plan.tree.leaves)}
        self._cycles = self._productions = 0

    def see(self, port: Port[Message], message: Message) -> None:
        """Take in a message; those that the series does not need are ignored."""
        cycle, of_inverters = message.cycle, self._of_inverters
        match message:
            case Dispatch():
                for name, values in self._of_plant.items():
                    values.add(cycle, getattr(message, name))
            case Production() if 0 <= cycle < self._plan.cycles:
                self._cycles = max(self._cycles, cycle + 1)
                self._productions += 1
                made = {"mpp_kw": message.inverter_mpp_kw, "power_kw": message.inverter_power_kw}
                for name, listed in made.items():
                    # An external plant may list too few or too many inverters.
                    for column, value in zip(of_inverters[name], listed, strict=False):
                        column.add(cycle, value)
            case Impp() if port.node in self._column:
                of_inverters["impp_kw"][self._column[port.node]].add(cycle, message.power_kw)
            case Residual() if port.node in self._column:
                of_inverters["residual_kw"][self._column[port.node]].add(cycle, message.power_kw)
            case Command():
                of_inverters["alpha"][self._column[port.node]].add(cycle, message.alpha)

    def series(self, label: str) -> RunSeries:
        """Return the cycles up to the last one that the plant completed."""
        cycles = self._cycles
        if not cycles:
            raise InputError("expected a run with at least one complete cycle, got none")
        if cycles > _MOST_APART * (self._productions + 1):
            raise InputError(
                f"expected production of most cycles up to {cycles - 1:,}, got that of "
                f"{self._productions:,}"
            )
        of_plant = {name: values.by_cycle(cycles) for name, values in self._of_plant.items()}
        of_inverters = {
            name: np.column_stack([values.by_cycle(cycles) for values in columns])
            for name, columns in self._of_inverters.items()
        }
        series = RunSeries.of(self._plan, label, **of_plant, **of_inverters)
        if not series.known.any():
            raise InputError("expected a cycle with dispatch and production, got none")
        return series


def read_series(path: Path) -> RunSeries:
    return _read(path, DISPATCH, IMPP, RESIDUAL, COMMAND, PRODUCTION)


def read_plant_series(path: Path) -> RunSeries:
    """Read what the figures of merit need of a recording: NaN stands for IMPP, residual, alpha."""
    return _read(path, DISPATCH, PRODUCTION)


def _read(path: Path, *signals: Signal[Message]) -> RunSeries:
    with RunReader(path) as reader:
        collector = SeriesCollector(reader.plan)
        for port, message in reader.messages(*signals):
            collector.see(port, message)
        try:
            return collector.series(reader.plan.run_id)
        except InputError as error:
            raise InputError(f"{reader.path}: {error}") from None
