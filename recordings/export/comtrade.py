"""A window of a recording around an event as COMTRADE, which viewers of relay records open.

Configuration and data are those of IEEE C37.111-2013 in ASCII, one sample for each cycle. The one
library of PyPI that writes the format always gives the time of writing as the time of the record.
"""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from math import nan
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bus_schemas.tree import parent_of
from recordings.inspect.agent_states import states_of
from recordings.read.reader import RunReader
from recordings.read.series import RunSeries, plant_series_of
from sim_plant.orders import is_ordered

_LARGEST: Final = 99_998
_MISSING: Final = 99_999
"""What the standard has for the largest value in ASCII, and for one that is not known."""

_LARGEST_STAMP: Final = 2**31 - 1
_ANALOG: Final = (
    *(("delivered", "delivered_kw", "kW"), ("desired", "desired_kw", "kW")),
    *(("dispatch", "dispatch_kw", "kW"), ("available", "available_kw", "kW")),
    ("frequency", "frequency_hz", "Hz"),
)
"""Channels of the plant: name, field of the series, unit."""

_Values = NDArray[np.float64]
_States = NDArray[np.bool_]


def write_comtrade(reader: RunReader, folder: Path, at: int, window: range) -> list[str]:
    """Write `run.cfg` and `run.dat` of some cycles into a new folder; return their channels.

    The trigger is the beginning of the cycle `at`.
    """
    series = plant_series_of(reader)
    analog, digital = _analog(series), _digital(series, reader, window)
    rows = slice(window.start, window.stop)
    channels, columns = [], []
    for number, (name, unit, values) in enumerate(analog, start=1):
        # The plant may not have completed the last cycles of a recording.
        missing = len(window) - len(values[rows])
        scale, offset, counts = _scaled(np.pad(values[rows], (0, missing), constant_values=nan))
        fields = (scale, offset, 0, -_LARGEST, _LARGEST, 1, 1, "P")
        channels.append(",".join(map(str, (number, name, "", "", unit, *fields))))
        columns.append(counts)
    for number, (name, states) in enumerate(digital, start=1):
        channels.append(f"{number},{name},,,0")
        known = np.pad(states[rows], (0, len(window) - len(states[rows])))
        columns.append(known.astype(np.int64))
    cycle_us = reader.plan.timing.cycle_ns / 1000
    unit_us = 1
    while len(window) * cycle_us / unit_us > _LARGEST_STAMP:
        unit_us *= 10
    stamps = [round(number * cycle_us / unit_us) for number in range(len(window))]
    start, trigger = reader.clock.local(window.start), reader.clock.local(at)
    zone = _offset(start)
    lines = (
        f"{reader.plan.plant},{reader.plan.run_id},2013",
        f"{len(columns)},{len(analog)}A,{len(digital)}D",
        *channels,
        str(reader.plan.grid_law.nominal_hz),
        # No sampling rate: the time stamps hold, which are exact for any length of cycle.
        *("0", f"0,{len(window)}"),
        *(f"{moment:%d/%m/%Y,%H:%M:%S.%f}" for moment in (start, trigger)),
        *("ASCII", str(unit_us), f"{zone},{zone}", "F,0"),
    )
    folder.mkdir()
    _write(folder / "run.cfg", lines)
    numbers = range(1, len(window) + 1)
    samples = zip(numbers, stamps, *(one.tolist() for one in columns), strict=True)
    _write(folder / "run.dat", (",".join(map(str, sample)) for sample in samples))
    return [*(name for name, *_ in analog), *(name for name, _ in digital)]


def _write(path: Path, lines: Iterable[str]) -> None:
    path.write_text("".join(f"{line}\r\n" for line in lines), encoding="utf-8", newline="")


def _analog(series: RunSeries) -> list[tuple[str, str, _Values]]:
    """Return name, unit and values of the channels: of all, each cluster, meter and storage."""
    found = [(name, unit, np.asarray(getattr(series, field))) for name, field, unit in _ANALOG]
    nodes = series.inverters
    clusters = nodes if series.noun == "cluster" else tuple(map(parent_of, nodes))
    for cluster in dict.fromkeys(clusters):
        own = [column for column, one in enumerate(clusters) if one == cluster]
        found.append((f"{cluster or 'plant'} power", "kW", series.power_kw[:, own].sum(axis=1)))
    for plant in series.meters.plants:
        fed_in_kw = series.meters.plant_kw(plant, series.power_kw, series.storage_power_kw)
        found.append((f"{plant} delivered", "kW", fed_in_kw))
    for column, storage in enumerate(series.plan.tree.storage_paths):
        found.append((f"{storage} power", "kW", series.storage_power_kw[:, column]))
        found.append((f"{storage} stored", "kWh", series.storage_energy_kwh[:, column]))
    return found


def _digital(series: RunSeries, reader: RunReader, window: range) -> list[tuple[str, _States]]:
    """Return when an order was in force, the frequency was answered, and each agent was gone."""
    in_force = np.zeros(series.cycles, bool)
    for dispatch in series.orders:
        in_force[dispatch.cycle :] = is_ordered(dispatch)
    found = {"order in force": in_force, "frequency response": series.response_kw != 0.0}
    for span in states_of(reader).spans():
        if span.end <= window.start or span.first_cycle >= window.stop:
            continue
        rows = found.setdefault(f"{span.agent} {span.kind}", np.zeros(series.cycles, bool))
        rows[span.first_cycle : span.end] = True
    return list(found.items())


def _scaled(values: _Values) -> tuple[float, float, NDArray[np.int64]]:
    """Return multiplier, offset, and the whole numbers that give the values back with them."""
    known = np.isfinite(values)
    low, high = (values[known].min(), values[known].max()) if known.any() else (0.0, 0.0)
    offset, half = float(low + high) / 2.0, float(high - low) / 2.0
    scale = half / _LARGEST or 1.0
    counts = np.full(len(values), _MISSING)
    counts[known] = np.rint((values[known] - offset) / scale)
    return scale, offset, counts


def _offset(moment: datetime) -> str:
    """Return the offset of a local time from UTC as the standard writes it: -10, +5h30."""
    away = moment.utcoffset()
    minutes = round(away.total_seconds() / 60) if away else 0
    hours, rest = divmod(abs(minutes), 60)
    return f"{'-' if minutes < 0 else '+'}{hours}{f'h{rest:02}' if rest else ''}"
