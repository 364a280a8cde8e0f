"""The grid's frequency: from a file, or nominal with events of a stated depth and rate."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import pandas as pd
from msgspec import Meta

from bus_schemas.faults import Second
from sim_plant import Floats
from sim_plant.csv_tables import held_values


class FrequencyFile(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="file"
):
    """A measured frequency.

    path: CSV: seconds since cycle 0 or local time stamps, then the frequency [Hz].
    column: Column to take, of several.
    """

    path: str
    column: str | None = None


class FrequencyEvent(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A departure from the nominal frequency, which returns at the same rate.

    at: Beginning, in simulated time since cycle 0 [s].
    depth_hz: How far it goes; an under-frequency is below 0 [Hz].
    rate_hz_per_s: How fast [Hz/s].
    duration_s: Time until it begins to return [s].
    step: Go and return at once, at no rate.
    """

    at: Second
    depth_hz: Annotated[float, Meta(ge=-5.0, le=5.0)]
    rate_hz_per_s: Annotated[float, Meta(gt=0.0, le=100.0)] = 0.1
    duration_s: Annotated[float, Meta(gt=0.0, le=1e6)] = 60.0
    step: bool = False

    def deviation_hz(self, time_s: Floats) -> Floats:
        """Return the departure at some times [s since cycle 0], shape (T,)."""
        if self.step:
            since_s = time_s - self.at + 1e-9
            return np.where((since_s >= 0.0) & (since_s < self.duration_s), self.depth_hz, 0.0)
        since_s = np.maximum(time_s - self.at, 0.0)
        gone_hz = self.rate_hz_per_s * np.minimum(since_s, self.duration_s)
        back_hz = self.rate_hz_per_s * np.maximum(since_s - self.duration_s, 0.0)
        reached_hz = min(abs(self.depth_hz), self.rate_hz_per_s * self.duration_s)
        size_hz = np.maximum(np.minimum(gone_hz, reached_hz) - back_hz, 0.0)
        return np.asarray(np.sign(self.depth_hz) * size_hz)


class FrequencyEvents(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="events"
):
    """The nominal frequency, with events. Departures of events that overlap add up."""

    events: tuple[FrequencyEvent, ...]


FrequencySettings = FrequencyFile | FrequencyEvents


def frequency_hz(
    settings: FrequencySettings | None,
    cycles: int,
    cycle_s: float,
    nominal_hz: float,
    find_file: Callable[[str], Path],
    begins: pd.Timestamp,
) -> tuple[Floats, tuple[str, ...]]:
    """Return the frequency at the beginning of each cycle, shape (T,), and notes on its file.

    By default it is nominal. `find_file` returns the path of a file that the settings name;
    `begins` is the local time of cycle 0.
    """
    time_s = np.arange(cycles, dtype=np.float64) * cycle_s
    if isinstance(settings, FrequencyFile):
        time_ns = np.rint(time_s * 1e9).astype(np.int64)
        what, path = "the frequency of every cycle", find_file(settings.path)
        bounds, column = (10.0, 110.0), settings.column
        return held_values(path, time_ns, bounds, what, begins=begins, column=column)
    away_hz = [event.deviation_hz(time_s) for event in settings.events] if settings else []
    return np.asarray(sum(away_hz, start=np.full(cycles, nominal_hz))), ()
