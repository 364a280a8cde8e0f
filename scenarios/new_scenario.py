"""A first scenario for measured irradiance, written from its two CSV files."""

from __future__ import annotations

import dataclasses
import json
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
import pandas as pd
from msgspec.structs import replace

from bus_schemas.errors import InputError, listed
from bus_schemas.tree import RESERVED_NAMES
from scenarios.fields import checked
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import Scenario, ScenarioFile
from scenarios.times import LONGEST_S, SHORTEST_CYCLE_S, on_day
from sim_plant.clear_sky import brightest_hour, clear_ghi, hours_from_noon, step_s, zone_by_sun
from sim_plant.csv_tables import CsvTable, read_csv
from sim_plant.irradiance import (
    Irradiance,
    StatedForm,
    measured_ghi,
    read_positions,
    station_of,
    wide,
)

_SHORTEST: Final = pd.Timedelta(seconds=SHORTEST_CYCLE_S)
_LENGTH: Final = pd.Timedelta(hours=1)
_INVERTER_KW: Final = 500
_MOST_SHOWN: Final = 10_000
"""Lines of the data from which their zone, and their share of a clear sky, is worked out."""

_CLUSTER: Final = 5
"""About so many inverters have a supervisor."""

_TEXT: Final = """\
# Written from {ghi_name} and {positions_name}. Lines with CHECK hold what these files do not say.
# docs/scenarios.md has all fields, also those that are not here.
name = {name}
title = {title}

[time]
start = {start}  # the brightest part of {ghi_name}
timezone = {timezone}  # CHECK: by the time stamps; a name such as "Europe/Berlin" also works
duration_s = {duration_s:g}
cycle_s = {cycle_s:g}  # the step of the data; a shorter cycle is interpolated

[plant]
rating_kw = {rating_kw}  # CHECK: AC, in equal parts: one inverter at each station
altitude_m = 0  # CHECK
actuator = "limit"  # or "fraction": docs/scenarios.md says which inverters are which

[irradiance]
kind = "measured"
ghi = {ghi}
positions = {positions}
stations = {stations}
{fill}
[pv]
tilt_deg = 0  # CHECK: flat modules, DC as large as AC
azimuth_deg = 180
dc_ac_ratio = 1.0

[commitment]
kind = "share-of-clear-sky"  # CHECK: what the plant promises; "file" reads a schedule
share = 0.4

[control]
cluster_count = [{clusters}]
clusters = "geographic"  # or "correlation", from the data below

[neighbours]
history = "hindsight"  # the order of help comes from the run's own data
"""


def measured_scenario(
    positions_csv: Path, ghi_csv: Path, out: Path, form: StatedForm, origin: str = ""
) -> tuple[str, Irradiance, list[str]]:
    """Return the TOML of a scenario that stands at `out` and runs on two files, the data, remarks.

    It takes the stations that both files have, and the brightest hour of the irradiance. `origin`
    is said in the scenario: where the irradiance comes from.
    """
    positions = read_positions(positions_csv)
    table = wide(read_csv(ghi_csv), tuple(positions.index))
    columns = [station_of(name, positions.index) for name in table.value_columns]
    stations = [name for name in columns if name in positions.index]
    if not stations:
        raise InputError(
            f"{ghi_csv.name}: line 1: expected a column for stations of {positions_csv.name}, got "
            f"{', '.join(table.value_columns)}"
        )
    is_guess = not (table.is_zoned or form.timezone)
    if is_guess:
        zone, is_told = _guessed_zone(table, stations, positions, form)
        form = replace(form, timezone=zone)
    found = measured_ghi(table, positions, positions_csv.name, stations, LONGEST_S, form)
    text = f"# {origin}\n" if origin else ""
    text += _text(table, found, positions_csv, out, form)
    scenario = checked(msgspec.toml.decode(text), Scenario, str(out), text)
    # What is written runs at once, or is refused now.
    file = ScenarioFile(scenario, text, out, out.parent, text)
    prepared = prepare(file, RunOptions(), "init", read=found)
    remarks = [
        f"left out, since only {path.name} has it: {listed(sorted(names - set(stations)))}"
        for path, names in ((ghi_csv, set(columns) - {""}), (positions_csv, set(positions.index)))
        if names - set(stations)
    ]
    if is_guess:
        minutes = (found.times[-1] - found.times[0]).total_seconds() / 60.0
        guess = f"it cannot be told from these {minutes:,.0f} min; assumed {zone}"
        told = f"the sun's path fits {zone} best" if is_told else guess
        remarks.append(f"--timezone was not given: {told}")
    if not found.ghi_wm2.to_numpy().any():
        remarks.append(f"the GHI in {ghi_csv.name} is 0 throughout: the plant has no power")
    return text, found, [*remarks, *prepared.remarks]


def _quoted(value: object) -> str:
    """Return a text, or several, as TOML has them: its escapes know no pairs of surrogates."""
    return json.dumps(value, ensure_ascii=False)


def _guessed_zone(
    table: CsvTable, stations: Sequence[str], positions: pd.DataFrame, form: StatedForm
) -> tuple[str, bool]:
    some = slice(None, None, len(table.fields) // _MOST_SHOWN + 1)
    fields, stamps = table.fields.iloc[some], table.stamps.iloc[some]
    table = dataclasses.replace(table, fields=fields, stamps=stamps, notes=[])
    naive = table.times("UTC", form.dates).tz_localize(None)
    known = positions.index
    columns = [name for name in table.value_columns if station_of(name, known) in stations]
    ghi_wm2 = table.numbers(columns, empty_is_missing=True, sentinels=True).mean(axis=1)
    return zone_by_sun(naive, ghi_wm2, positions.loc[list(stations)])


def _text(
    table: CsvTable, found: Irradiance, positions_csv: Path, out: Path, form: StatedForm
) -> str:
    step = pd.Timedelta(found.times[1] - found.times[0])
    if not _SHORTEST <= step <= _LENGTH:
        raise InputError(
            f"{table.name}: expected a step of {_SHORTEST.total_seconds():g} s to an hour, got "
            f"{step.total_seconds():g} s"
        )
    stations = list(found.sensors)
    steps = min(max(int(_LENGTH / step), 1), len(found.times))
    means = found.ghi_wm2.mean(axis=1).rolling(steps).mean().to_numpy()[steps - 1 :]
    zone = form.timezone or _timezone(str(table.stamps.iloc[0]))
    names = ("timezone", "dates", "unit")
    lines = [f"{name} = {_quoted(value)}" for name in names if (value := getattr(form, name))]
    if stamps := form.stamps or found.stamps:
        lines.append(f"stamps = {_quoted(stamps)}  # CHECK: what a time stamp names")
    if found.longest_gap_s:
        lines.append(f"max_gap_s = {found.longest_gap_s:g}  # {found.report[-1]}")
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", out.stem).strip("-")
    ghi_csv = Path(found.source)
    return _TEXT.format(
        ghi_name=table.name,
        positions_name=positions_csv.name,
        name=_quoted(f"my-{name}"[:40] if not name or name in RESERVED_NAMES else name[:40]),
        title=_quoted(f"{len(stations)} inverters under the sun of {table.name}"),
        start=_start(found.times[int(means.argmax())], zone),
        timezone=_quoted(zone),
        duration_s=steps * step.total_seconds(),
        cycle_s=step.total_seconds(),
        rating_kw=_INVERTER_KW * len(stations),
        ghi=_quoted(os.path.relpath(ghi_csv, out.parent)),
        positions=_quoted(os.path.relpath(positions_csv, out.parent)),
        stations=_quoted(stations),
        fill="".join(f"{line}\n" for line in lines),
        clusters=max(round(len(stations) / _CLUSTER), 1),
    )


def _start(begin: pd.Timestamp, zone: str) -> str:
    """Return a local time; with its offset where the clocks show it twice."""
    local = begin.tz_convert(zone).to_pydatetime()
    naive = local.replace(tzinfo=None, fold=0)
    is_one = len(on_day(naive, local, "start")) == 1
    return (naive if is_one else local).isoformat()


def _timezone(stamp: str) -> str:
    """Return the IANA name of a time stamp's offset in whole hours; UTC for all others."""
    found = re.search(r":\d\d(?:\.\d+)? ?([+-]\d\d)(?::?00)?$", stamp)
    hours = int(found[1]) if found else 0
    return f"Etc/GMT{-hours:+d}" if hours else "UTC"  # POSIX counts west as positive.


def preview_table(found: Irradiance) -> list[str]:
    """Say in a few lines what measured irradiance holds."""
    times, mean_wm2 = found.times, found.ghi_wm2.mean(axis=1)
    some_wm2 = mean_wm2.iloc[:: len(times) // _MOST_SHOWN + 1]
    energy = float(np.nansum(clear_ghi(pd.DatetimeIndex(some_wm2.index), found.coordinates)))
    share = f"{100.0 * float(some_wm2.sum()) / energy:.0f} % of a clear sky" if energy else "night"
    off_h = hours_from_noon(mean_wm2, found.coordinates)
    return [
        f"data: {len(found.sensors)} stations, {times[0]:%Y-%m-%d %H:%M} to "
        f"{times[-1]:%Y-%m-%d %H:%M} UTC, a value each {step_s(times):g} s",
        f"gaps: {f'up to {found.longest_gap_s:g} s, filled' if found.longest_gap_s else 'none'}",
        f"brightest hour: {brightest_hour(mean_wm2):%Y-%m-%d %H:%M} UTC, "
        f"{abs(off_h):.1f} h {'after' if off_h >= 0 else 'before'} solar noon",
        f"irradiance: {float(mean_wm2.max()):.0f} W/m2 at most, {share}",
    ]
