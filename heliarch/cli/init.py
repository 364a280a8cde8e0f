"""`heliarch init`: a first scenario from one's own data."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Final, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from bus_schemas.whole_file import check_new, whole_file
from heliarch.cli.options import FILES
from heliarch.cli.output import Output

_SPEED: Final = Number(gte=0, lte=100)
_DIRECTION: Final = Number(gte=0, lte=360)


def init(
    positions: Path,
    ghi: str,
    /,
    *,
    out: Annotated[Path, Parameter(group=FILES, metavar="FILE")] = Path("my-plant.toml"),
    preview: Annotated[Path | None, Parameter(group=FILES, metavar="FILE.html|png")] = None,
    timezone: Annotated[str | None, Parameter(metavar="ZONE")] = None,
    dates: Literal["day-first", "month-first"] | None = None,
    unit: Literal["W/m2", "kW/m2"] | None = None,
    stamps: Literal["begin", "middle", "end"] | None = None,
    cloud_speed: Annotated[float, Parameter(metavar="M/S", validator=_SPEED)] = 10.0,
    cloud_from: Annotated[float, Parameter(metavar="DEG", validator=_DIRECTION)] = 270.0,
) -> None:
    """Write a scenario for measured irradiance, which runs at once.

    Prints what the files hold, and what of them was assumed, changed or left out.

    Example: `heliarch init positions.csv ghi.csv --out mesa.toml`

    Parameters
    ----------
    positions
        CSV with the columns `station, lat, lon`.
    ghi
        CSV: time stamps, then a column of GHI [W/m^2] for each station. Or a file of an archive, by
        its content or as srml:FILE (surfrad, midc, bsrn, psm3, psm4, epw, tmy3, solaranywhere,
        solcast, pvgis), with one station, whose clouds move over the plant.
    out
        The new scenario.
    preview
        Draw the irradiance beside a clear sky.
    timezone
        Zone of time stamps without an offset, such as Europe/Berlin; default: by the sun's path.
    dates
        Whether the day or the month comes first, where the time stamps leave it open.
    unit
        Unit of the values, where the header does not say it.
    stamps
        Which moment of its interval a time stamp names; default: by the header or the sun's path.
    cloud_speed
        Of an archive: speed of the clouds over the plant [m/s]; 0: all inverters see the same.
    cloud_from
        Of an archive: where the clouds come from, in degrees clockwise from north.
    """
    from rich.console import Console

    from scenarios.new_scenario import measured_scenario, preview_table
    from scenarios.scenario import check_timezone
    from sim_plant.archives import archive_of, cloud_text, plant_under, read_archive
    from sim_plant.irradiance import StatedForm, read_positions

    if timezone is not None:
        check_timezone(timezone, "--timezone")
    check_new(out)
    if preview is not None:
        from results.report.irradiance_preview import check_preview, write_preview

        check_preview(preview)
    form = StatedForm(timezone=timezone, dates=dates, unit=unit, stamps=stamps)
    with Console(stderr=True).status(f"reading {ghi}"):
        path, origin = Path(ghi), ""
        if archive := archive_of(ghi):
            path = out.with_name(f"{out.stem}-ghi.csv")
            check_new(path)
            series, places = read_archive(*archive), read_positions(positions)
            plant_under(series, places, cloud_speed, cloud_from).round(2).to_csv(
                path, index_label="begin"
            )
            origin = cloud_text(archive[0], archive[1].name, cloud_speed, cloud_from)
        text, found, remarks = measured_scenario(positions, path, out, form, origin)
    with whole_file(out) as file:
        file.write(text.encode())
    lines = preview_table(found)
    if preview is not None:
        write_preview(found, [*lines, *remarks], preview)
        lines.append(f"preview: {preview}")
    Output().say(
        *lines,
        *([f"irradiance: {origin}"] if origin else []),
        f"scenario: {out}; its lines with CHECK hold what the files do not say",
        *remarks,
        f"run it: heliarch simulate {shlex.quote(str(out))} --report",
    )
