"""A run as arrays, one row for each cycle: what metrics and figures are computed from.

A recording, agents in memory and the array model all give a `RunSeries`, so there is one code for
the figures of merit.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from math import isnan, nan
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
        power, power that it delivered, IMPP, IMPP less share, and the curtailment level in [0, 1]
        that it applied.
    ramp_limit_percent_per_min: Ramp limit in % of the plant's rating per minute, if a grid code
        sets one.
    missed_inputs: How many inputs had not come at a deadline; None: not counted.
    reverted_percent: Share of the inverters' cycles without a command for the revert time; None:
        not counted.
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
    missed_inputs: int | None = None
    reverted_percent: float | None = None

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
            timezone=plan.timing.timezone,
            start_time_ns=plan.timing.start_time_ns,
            cycle_s=plan.timing.cycle_ns / 1e9,
            regulation_capacity_kw=plan.site.regulation_capacity_kw,
            ramp_limit_percent_per_min=plan.site.ramp_limit_percent_per_min,
            missed_inputs=None,
            reverted_percent=None,
            **(unknown | values),
        )

    @property
    def cycles(self) -> int:
        return len(self.mpp_kw)

    @property
    def dispatch_kw(self) -> NDArray[np.float64]:
        """Commitment plus regulation, the paper's P_desired, shape (T,)."""
        return self.commitment_kw + self.regulation_kw

    @property
    def available_kw(self) -> NDArray[np.float64]:
        """True maximum power of the plant, shape (T,)."""
        return np.asarray(self.mpp_kw.sum(axis=1))

    @property
    def delivered_kw(self) -> NDArray[np.float64]:
        """Power of the plant, shape (T,)."""
        return np.asarray(self.power_kw.sum(axis=1))

    @property
    def shortfall_kw(self) -> NDArray[np.float64]:
        """Power that others had to give, max(0, P_desired - P), shape (T,)."""
        return np.maximum(self.dispatch_kw - self.delivered_kw, 0.0)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether the recording has dispatch and production of each cycle, shape (T,)."""
        return np.isfinite(self.dispatch_kw) & np.isfinite(self.available_kw + self.delivered_kw)

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


class SeriesCollector:
    """Turns the messages of a run, live or from a recording, into a `RunSeries`."""

    def __init__(self, plan: RunPlan) -> None:
        self._plan = plan
        self._column = {leaf: column for column, leaf in enumerate(plan.tree.leaves)}
        self._of_plant = {name: np.full(plan.timing.cycles, nan) for name in _OF_PLANT}
        self._of_inverters = defaultdict[str, NDArray[np.float64]](
            lambda: np.full((plan.timing.cycles, len(self._column)), nan)
        )
        self._cycles = 0

    def see(self, port: Port[Message], message: Message) -> None:
        """Take in a message; those that the series does not need are ignored."""
        cycle = message.cycle
        if not 0 <= cycle < self._plan.timing.cycles:
            return
        match message:
            case Dispatch():
                for name, values in self._of_plant.items():
                    _enter(values, cycle, getattr(message, name))
            case Production():
                self._cycles = max(self._cycles, cycle + 1)
                made = {"mpp_kw": message.inverter_mpp_kw, "power_kw": message.inverter_power_kw}
                for name, listed in made.items():
                    # An external plant may list too few or too many inverters.
                    for column, value in zip(self._column.values(), listed, strict=False):
                        _enter(self._of_inverters[name], (cycle, column), value)
            case Impp() if port.node in self._column:
                self._enter_of(port, "impp_kw", cycle, message.power_kw)
            case Residual() if port.node in self._column:
                self._enter_of(port, "residual_kw", cycle, message.power_kw)
            case Command():
                self._enter_of(port, "alpha", cycle, message.alpha)

    def _enter_of(self, port: Port[Message], name: str, cycle: int, value: float) -> None:
        _enter(self._of_inverters[name], (cycle, self._column[port.node]), value)

    def series(self, label: str) -> RunSeries:
        """Return the cycles up to the last one that the plant completed."""
        if not self._cycles:
            raise InputError("expected a run with at least one complete cycle, got none")
        columns = self._of_plant | self._of_inverters
        values = {name: column[: self._cycles] for name, column in columns.items()}
        series = RunSeries.of(self._plan, label, **values)
        known = int(series.known.sum())
        if known * _MOST_APART <= series.cycles:
            raise InputError(
                f"expected dispatch and production of most of {series.cycles:,} cycles, got those "
                f"of {known:,}"
            )
        return series


def _enter(values: NDArray[np.float64], index: int | tuple[int, int], value: float) -> None:
    """Enter a number, unless an earlier message gave one."""
    if isnan(values[index]):
        values[index] = value


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
