"""`heliarch init`: a first scenario from one's own data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

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
) -> None:
    """Write a scenario for measured irradiance, which runs at once.

    Example: `heliarch init positions.csv ghi.csv --out mesa.toml`

    Parameters
    ----------
    positions
        CSV with the columns `station, lat, lon`.
    ghi
        CSV: time stamps with their offset from UTC, then a column of GHI [W/m^2] for each station.
    out
        The new scenario.
    """
    from scenarios.new_scenario import measured_scenario

    check_new(out)
    text, remarks = measured_scenario(positions, ghi, out)
    with whole_file(out) as file:
        file.write(text.encode())
    Output().say(
        f"scenario: {out}; its lines with CHECK hold what the files do not say",
        *remarks,
        f"run it: heliarch simulate {out} --report",
    )
