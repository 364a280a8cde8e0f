"""Regulation: the power that the market asks for, up and down, on top of the commitment.

A regulation signal in per unit of the offered capacity, measured (a file) or synthetic, is held
from each of its values to the next and read at the beginning of every cycle. The controllers, not
this module, handle a dispatch below 0 or above the plant's rating.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import time
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Final, TypeAlias

import msgspec
import numpy as np
import pandas as pd
from msgspec import Meta
from numpy.typing import NDArray

from sim_plant import Floats
from sim_plant.csv_tables import held_values
from sim_plant.synthetic_regd import SAMPLES, STEP_S, synthetic_regd

_NS: Final = 1_000_000_000
_DAY_NS: Final = 86_400 * _NS


_LocalTime: TypeAlias = Annotated[time, Meta(tz=False)]


class _Offer(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"
):
    """What the plant offers, and when.

    capacity_kw: Power that a signal of +1 asks for, on top of the rest [kW].
    offered_from: Local time from which it is offered. Default: midnight.
    offered_to: Local time of its end; if not after `from`, on the next day.
    """

    capacity_kw: Annotated[float, Meta(gt=0.0, le=1e8)]
    offered_from: _LocalTime | None = msgspec.field(default=None, name="from")
    offered_to: _LocalTime | None = msgspec.field(default=None, name="to")


class RegulationFile(_Offer, frozen=True, tag="file"):
    """A signal from a file.

    path: CSV: seconds of the signal's clock, times of day or time stamps, then the signal from -1
        to 1 (+: raise).
    column: Column to take, of several. Default: that of the run's first day.
    signal_midnight_s: Second of the signal at local midnight of the run's first day.
    """

    path: str
    column: str | None = None
    signal_midnight_s: Annotated[float, Meta(ge=-1e9, le=1e9)] = 0.0


class SyntheticRegulation(_Offer, frozen=True, tag="synthetic"):
    """A synthetic signal that moves like PJM's RegD.

    seed: Seed of the signal.
    """

    seed: Annotated[int, Meta(ge=0, le=2**32)] = 0


RegulationSettings = RegulationFile | SyntheticRegulation


def regulation_kw(
    settings: RegulationSettings,
    times: pd.DatetimeIndex,
    timezone: str,
    find_file: Callable[[str], Path],
) -> tuple[Floats, tuple[str, ...]]:
    """Return the regulation that is asked of the plant in every cycle, shape (T,), and notes.

    It goes from -capacity to +capacity [kW], and is 0 while none is offered. `timezone` is the
    local time of the plant, an IANA name; `find_file` returns the path of a file that the settings
    name.
    """
    # The signal's clock is that of the wall: it leaps with the summer time, as market hours do.
    clock_ns = times.tz_convert(timezone).tz_localize(None).as_unit("ns").asi8
    offered = _offered(settings, clock_ns)
    signal, notes = np.zeros(len(times)), tuple[str, ...]()
    if isinstance(settings, SyntheticRegulation):
        values = _synthetic(settings.seed)
        signal[offered] = values[clock_ns[offered] // (STEP_S * _NS) % SAMPLES]
    elif offered.any():
        midnight_ns = clock_ns[0] // _DAY_NS * _DAY_NS - round(settings.signal_midnight_s * _NS)
        path, what = find_file(settings.path), "a signal of the run's regulation"
        hint = "; regulation.signal_midnight_s shifts the signal"
        time_ns = clock_ns[offered] - midnight_ns
        midnight = times[0].tz_convert(timezone).normalize()
        signal[offered], notes = held_values(
            path,
            time_ns,
            (-1.0, 1.0),
            what,
            begins=midnight,
            column=settings.column,
            hint=hint,
        )
    return settings.capacity_kw * signal, notes


_synthetic = lru_cache(maxsize=1)(synthetic_regd)
"""All days of a study have the same signal."""


def _offered(settings: RegulationSettings, clock_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell in which cycles regulation is offered, shape (T,)."""
    begin_ns = _of_day_ns(settings.offered_from)
    end_ns = _of_day_ns(settings.offered_to) or _DAY_NS
    begun, not_over = clock_ns % _DAY_NS >= begin_ns, clock_ns % _DAY_NS < end_ns
    return np.asarray(begun & not_over if begin_ns < end_ns else begun | not_over)


def _of_day_ns(clock: time | None) -> int:
    return 0 if clock is None else pd.Timedelta(clock.isoformat()).as_unit("ns").value
