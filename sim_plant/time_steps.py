"""From the time step of measurements to the cycle of a run: block means, or lines between values.

A measured value stands for the step that begins at its time stamp. A cycle that is as long as the
step takes it as it is; a cycle of several steps takes their mean, which keeps the energy; a cycle
that is shorter lies on the straight line between one value and the next. The last value has no
next and holds for its step.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd

from bus_schemas.errors import InputError
from sim_plant import Floats

_NS: Final = 1_000_000_000


def step_ns(times: pd.DatetimeIndex) -> int:
    """Return the step of time stamps [ns]; that of their frequency where there is only one."""
    if len(times) > 1:
        # Hours that do not follow each other leave a gap: the step is the least difference.
        return int(np.diff(times.as_unit("ns").asi8).min())
    assert times.freq is not None
    return int((times[0] + times.freq - times[0]).value)


def on_cycles(
    times: pd.DatetimeIndex, values: Floats, cycles: pd.DatetimeIndex, source: str
) -> Floats:
    """Bring N measured series to the K cycles of a run, shape (K, N), as described above.

    `cycles` are the beginnings of the cycles, ascending; hours between them may be left out. A
    cycle that begins between two time stamps and is not shorter than the step begins with the
    earlier. `source` is what the measurements were read from, for the error that they do not cover
    the cycles, or that the cycle is longer than their step and no multiple of it.
    """
    step, cycle = step_ns(times), step_ns(cycles)
    if cycle > step and cycle % step:
        raise InputError(
            f"{source}: expected a time.cycle_s that is a multiple of its step, {step / _NS:g} s, "
            f"or shorter, got {cycle / _NS:g} s"
        )
    check_coverage(f"{source}: expected measurements", times, step, cycles)
    if cycle < step:
        return _on_lines(times, values, cycles)
    first = times.searchsorted(cycles, side="right") - 1
    if cycle == step:
        return values[first]
    mean: Floats = values[first[:, None] + np.arange(cycle // step)].mean(axis=1)
    return mean


def _on_lines(times: pd.DatetimeIndex, values: Floats, cycles: pd.DatetimeIndex) -> Floats:
    # Times since the first cycle's value: a float cannot hold nanoseconds since 1970.
    origin = times[int(times.searchsorted(cycles[0], side="right")) - 1]
    known_s = (times - origin).total_seconds().to_numpy()
    wanted_s = (cycles - origin).total_seconds().to_numpy()
    return np.column_stack([np.interp(wanted_s, known_s, column) for column in values.T])


def check_coverage(
    expected: str, times: pd.DatetimeIndex, last_ns: int, cycles: pd.DatetimeIndex
) -> None:
    """Refuse times that do not cover the cycles of a run; the last one holds for `last_ns`."""
    begin, end = cycles[0], cycles[-1] + pd.Timedelta(step_ns(cycles), unit="ns")
    until = times[-1] + pd.Timedelta(last_ns, unit="ns")
    if begin < times[0] or end > until:
        wanted = f"{_utc(begin)} to {_utc(end)}"
        got = f"{_utc(times[0])} to {_utc(until)}"
        raise InputError(f"{expected} of {wanted}, got {got}")


def _utc(time: pd.Timestamp) -> str:
    return time.tz_convert("UTC").isoformat().replace("+00:00", "Z")
