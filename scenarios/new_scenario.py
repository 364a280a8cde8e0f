"""A first scenario for measured irradiance, written from its two CSV files."""

from __future__ import annotations

import json
import os
import re
from datetime import timedelta
from pathlib import Path
from typing import Final

import pandas as pd

from bus_schemas.errors import InputError, listed
from bus_schemas.tree import RESERVED_NAMES
from scenarios.times import LONGEST_S
from sim_plant.csv_tables import read_csv
from sim_plant.irradiance import read_measured_ghi

_LENGTH: Final = pd.Timedelta(hours=1)
_INVERTER_KW: Final = 500
_CLUSTER: Final = 5
"""About so many inverters have a supervisor."""

_TEXT: Final = """\
# Written from {ghi_name} and {positions_name}. Lines with CHECK hold what these files do not say.
# docs/scenarios.md has all fields, also those that are not here.
name = {name}
title = {title}

[time]
start = {start:%Y-%m-%dT%H:%M:%S}  # the brightest part of {ghi_name}
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


def measured_scenario(positions_csv: Path, ghi_csv: Path, out: Path) -> tuple[str, list[str]]:
    """Return the TOML of a scenario that stands at `out` and runs on these two files, and remarks.

    It takes the stations that both files have, and the brightest hour of the irradiance.
    """
    table, positions = read_csv(ghi_csv), read_csv(positions_csv)
    positions.check_header(("station", "lat", "lon"))
    known = set(positions.names("station"))
    stations = [name for name in table.header[1:] if name in known]
    if not stations:
        raise InputError(
            f"{ghi_csv.name}: line 1: expected a column for stations of {positions_csv.name}, got "
            f"{', '.join(table.header)}"
        )
    found = read_measured_ghi(ghi_csv, positions_csv, stations, LONGEST_S)
    step = pd.Timedelta(found.times[1] - found.times[0])
    steps = min(max(int(_LENGTH / step), 1), len(found.times))
    means = found.ghi_wm2.mean(axis=1).rolling(steps).mean().to_numpy()[steps - 1 :]
    offset = pd.Timestamp(table.text(table.header[0]).iloc[0]).utcoffset() or timedelta(0)
    fill = (
        ""
        if not found.report
        else f"""\
max_gap_s = {found.longest_gap_s:g}  # {found.report[0]}
"""
    )
    remarks = [
        f"left out, since only {path.name} has it: {listed(sorted(names - set(stations)))}"
        for path, names in ((ghi_csv, set(table.header[1:])), (positions_csv, known))
        if names - set(stations)
    ]
    if not found.ghi_wm2.to_numpy().any():
        remarks.append(f"the GHI in {ghi_csv.name} is 0 throughout: the plant has no power")
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", out.stem).strip("-")
    text = _TEXT.format(
        ghi_name=ghi_csv.name,
        positions_name=positions_csv.name,
        name=json.dumps(f"my-{name}" if not name or name in RESERVED_NAMES else name),
        title=json.dumps(f"{len(stations)} inverters under the sun of {ghi_csv.name}"),
        start=found.times[int(means.argmax())] + offset,
        timezone=json.dumps(_timezone(offset)),
        duration_s=steps * step.total_seconds(),
        cycle_s=step.total_seconds(),
        rating_kw=_INVERTER_KW * len(stations),
        ghi=json.dumps(os.path.relpath(ghi_csv, out.parent)),
        positions=json.dumps(os.path.relpath(positions_csv, out.parent)),
        stations=json.dumps(stations),
        fill=fill,
        clusters=max(round(len(stations) / _CLUSTER), 1),
    )
    return text, remarks


def _timezone(offset: timedelta) -> str:
    """Return the IANA name of an offset from UTC in whole hours; UTC for all others."""
    hours, rest = divmod(offset, timedelta(hours=1))
    # POSIX counts west of Greenwich as positive.
    return f"Etc/GMT{-hours:+d}" if hours and not rest else "UTC"
