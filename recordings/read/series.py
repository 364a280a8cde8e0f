"""A run as arrays, one row for each cycle: what metrics and figures are computed from.

A recording, agents in memory and the array model all give a `RunSeries`, so there is one code for
the figures of merit.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from bus_schemas.messages import Dispatch, Message, Production
from bus_schemas.signals import COMMAND, DISPATCH, IMPP, PRODUCTION, RESIDUAL, Port, Signal
from recordings.read.reader import RunReader

_MOST_APART: Final = 1000
"""A series has at least one cycle of so many; the rest would be gaps alone."""

_OF_INVERTERS: Final[tuple[Signal[Message], ...]] = (IMPP, RESIDUAL, COMMAND)


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
        return replace(
            self,
            start_time_ns=self.start_time_ns + round(first * self.cycle_s * 1e9),
            commitment_kw=self.commitment_kw[first:end],
            regulation_kw=self.regulation_kw[first:end],
            mpp_kw=self.mpp_kw[first:end],
            power_kw=self.power_kw[first:end],
            impp_kw=self.impp_kw[first:end],
            residual_kw=self.residual_kw[first:end],
            alpha=self.alpha[first:end],
        )


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
        leaves = plan.tree.leaves
        self._of_inverters = {
            signal.of(leaf): _Values() for signal in _OF_INVERTERS for leaf in leaves
        }
        self._commitment_kw, self._regulation_kw = _Values(), _Values()
        self._mpp_kw, self._power_kw = [_Values() for _ in leaves], [_Values() for _ in leaves]
        self._cycles = self._productions = 0

    def see(self, port: Port[Message], message: Message) -> None:
        """Take in a message; those that the series does not need are ignored."""
        cycle = message.cycle
        values = self._of_inverters.get(port)
        if values is not None:
            values.add(cycle, message.alpha if port.signal is COMMAND else message.power_kw)  # type: ignore[attr-defined]
        elif isinstance(message, Dispatch):
            self._commitment_kw.add(cycle, message.commitment_kw)
            self._regulation_kw.add(cycle, message.regulation_kw)
        elif isinstance(message, Production) and 0 <= cycle < self._plan.cycles:
            self._cycles = max(self._cycles, cycle + 1)
            self._productions += 1
            # An external plant may list too few or too many inverters.
            for column, value in zip(self._mpp_kw, message.inverter_mpp_kw, strict=False):
                column.add(cycle, value)
            for column, value in zip(self._power_kw, message.inverter_power_kw, strict=False):
                column.add(cycle, value)

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
        tree = self._plan.tree

        def stacked(columns: Iterable[_Values]) -> NDArray[np.float64]:
            return np.column_stack([column.by_cycle(cycles) for column in columns])

        def of_inverters(signal: Signal[Message]) -> NDArray[np.float64]:
            return stacked(self._of_inverters[signal.of(leaf)] for leaf in tree.leaves)

        series = RunSeries(
            label=label,
            inverters=tree.leaves,
            rating_kw=np.array([tree.rating_kw(leaf) for leaf in tree.leaves]),
            timezone=self._plan.timezone,
            start_time_ns=self._plan.start_time_ns,
            cycle_s=self._plan.cycle_ns / 1e9,
            commitment_kw=self._commitment_kw.by_cycle(cycles),
            regulation_kw=self._regulation_kw.by_cycle(cycles),
            regulation_capacity_kw=self._plan.regulation_capacity_kw,
            mpp_kw=stacked(self._mpp_kw),
            power_kw=stacked(self._power_kw),
            impp_kw=of_inverters(IMPP),
            residual_kw=of_inverters(RESIDUAL),
            alpha=of_inverters(COMMAND),
            ramp_limit_percent_per_min=self._plan.ramp_limit_percent_per_min,
        )
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
