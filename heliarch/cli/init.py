"""`heliarch init`: a first scenario from one's own data."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from bus_schemas.whole_file import check_new, whole_file
from heliarch.cli.options import FILES
from heliarch.cli.output import Output


def init(
    positions: Path,
    ghi: Path,
    /,
    *,
    out: Annotated[Path, Parameter(group=FILES, metavar="FILE")] = Path("my-plant.toml"),
    timezone: Annotated[str | None, Parameter(metavar="ZONE")] = None,
    dates: Literal["day-first", "month-first"] | None = None,
    unit: Literal["W/m2", "kW/m2"] | None = None,
    stamps: Literal["begin", "middle", "end"] | None = None,
) -> None:
    """Write a scenario for measured irradiance, which runs at once.

    Prints what the files hold, and what of them was assumed, changed or left out.

    Example: `heliarch init positions.csv ghi.csv --out mesa.toml`

    Parameters
    ----------
    positions
        CSV with the columns `station, lat, lon`.
    ghi
        CSV: time stamps, then a column of GHI [W/m^2] for each station.
    out
        The new scenario.
    timezone
        Zone of time stamps without an offset, such as Europe/Berlin; default: by the sun's path.
    dates
        Whether the day or the month comes first, where the time stamps leave it open.
    unit
        Unit of the values, where the header does not say it.
    stamps
        Which moment of its interval a time stamp names; default: by the header or the sun's path.
    """
    from rich.console import Console

    from scenarios.new_scenario import measured_scenario, preview_table
    from scenarios.scenario import check_timezone
    from sim_plant.irradiance import StatedForm

    if timezone is not None:
        check_timezone(timezone, "--timezone")
    check_new(out)
    form = StatedForm(timezone=timezone, dates=dates, unit=unit, stamps=stamps)
    with Console(stderr=True).status(f"reading {ghi.name}"):
        text, found, remarks = measured_scenario(positions, ghi, out, form)
    with whole_file(out) as file:
        file.write(text.encode())
    Output().say(
        *preview_table(found),
        f"scenario: {out}; its lines with CHECK hold what the files do not say",
        *remarks,
        f"run it: heliarch simulate {shlex.quote(str(out))} --report",
    )
