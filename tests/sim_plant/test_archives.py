"""Archives of one station, and the plant that its clouds make."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bus_schemas.errors import InputError
from sim_plant.archives import archive_of, plant_under, read_archive
from sim_plant.clear_sky import clear_ghi

PLACES = pd.DataFrame(
    {"lat": [40.0, 40.0, 40.009], "lon": [-105.0, -104.99, -105.0]}, ["a", "b", "c"]
)


def psm(folder: Path) -> Path:
    """Write an hour of NSRDB: two lines about the place, then the parts of the time."""
    about = {"Source": "NSRDB", "Location ID": 1, "Time Zone": -7, "Local Time Zone": -7}
    about |= {"Latitude": 40.0, "Longitude": -105.0, "Elevation": 1600}
    lines = [",".join(map(str, part)) for part in (about, about.values())]
    lines.append("Year,Month,Day,Hour,Minute,GHI,DNI,DHI")
    lines += [f"2024,6,15,12,{minute},{800 + minute},700,100" for minute in range(0, 60, 5)]
    path = folder / "psm.csv"
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return path


def solcast(folder: Path) -> Path:
    times = pd.date_range("2024-06-15T18:05", periods=12, freq="5min", tz="UTC")
    lines = [f"{800 + 5 * at},{time:%Y-%m-%dT%H:%M:%SZ},PT5M" for at, time in enumerate(times)]
    path = folder / "solcast.csv"
    path.write_text("\n".join(["ghi,period_end,period", *lines, ""]), encoding="utf-8")
    return path


def srml(folder: Path) -> Path:
    """Write two minutes of June 15: day of the year, time of its end, values with flags."""
    lines = ["94255\t2024\t1000\t0", "167\t1201\t800.0\t12", "167\t1202\t801.0\t12", ""]
    path = folder / "EUPO2406.txt"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def bsrn(folder: Path) -> Path:
    """Write two minutes of June 15: two lines of fixed widths each, GHI first, below the place."""
    lines = [
        "*U0001",
        " 99  6 2024  1",
        "*U0004",
        " 1  1 12 00",
        "  3  4",
        "roof",
        f"{'phone':20}fax",
    ]
    lines += [
        f"{'1.2.3.4':15}a@b.org",
        " 130.000  75.000 1600 12345",
        " 1  1 12 00",
        " -1 -1",
        "*U0100",
    ]

    def group(mean: int) -> str:
        return f"{mean:6d}{1.5:6.1f}{mean - 2:5d}{mean + 2:5d}"

    for minute, ghi in ((1080, 800), (1081, 801)):
        lines += [f" 15 {minute:5d} {group(ghi)} {group(700)}", f"{group(100):>32} {group(350)}"]
    path = folder / "roo0624.dat"
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return path


def pvgis(folder: Path, slope: int = 0) -> Path:
    """Write two hours on a plane, its irradiance in three parts."""
    place = "Latitude (decimal degrees): 40.000\nLongitude (decimal degrees): -105.000\n"
    base = "Elevation (m): 1600\nRadiation database: PVGIS-SARAH3\n\n"
    plane = f"Slope: {slope} deg.\nAzimuth: 0 deg.\ntime,Gb(i),Gd(i),Gr(i),H_sun,T2m,WS10m,Int\n"
    rows = [f"20230615:{hour}10,700.0,{80 + hour}.0,2.0,60.0,25.0,2.0,0.0\n" for hour in (18, 19)]
    path = folder / "pvgis.csv"
    path.write_text(f"{place}{base}{plane}{''.join(rows)}\nGb(i): beam\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("write", "kind", "begin", "first_wm2"),
    [
        (psm, "psm4", "2024-06-15T18:57:30", 800.0),
        (solcast, "solcast", "2024-06-15T18:00", 800.0),
        (srml, "srml", "2024-06-15T20:00", 800.0),
        (bsrn, "bsrn", "2024-06-15T18:00", 800.0),
        (pvgis, "pvgis", "2023-06-15T17:40", 800.0),
    ],
)
def test_archives_are_recognised_by_content_and_read_by_the_begin_of_an_interval(
    tmp_path: Path, write: Callable[[Path], Path], kind: str, begin: str, first_wm2: float
) -> None:
    found = archive_of(str(write(tmp_path)))
    assert found is not None
    assert found[0] == kind
    ghi_wm2 = read_archive(*found)
    assert ghi_wm2.index[0] == pd.Timestamp(begin, tz="UTC")
    assert ghi_wm2.iloc[0] == first_wm2


def test_irradiance_on_a_tilted_plane_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="tilted plane"):
        read_archive("pvgis", pvgis(tmp_path, slope=35))


def test_the_word_of_an_archive_counts_and_other_files_are_none(tmp_path: Path) -> None:
    assert archive_of(f"psm3:{psm(tmp_path)}") == ("psm3", psm(tmp_path))
    (tmp_path / "ghi.csv").write_text("time,p1\n2024-06-15T19:00:00Z,800\n", encoding="utf-8")
    assert archive_of(str(tmp_path / "ghi.csv")) is None
    with pytest.raises(InputError, match=r"one of the archives .* did you mean surfrad"):
        archive_of("surfrat:x.dat")
    with pytest.raises(InputError, match=r"expected a file of epw, got: \w"):
        read_archive("epw", tmp_path / "ghi.csv")
    with pytest.raises(InputError, match="expected a file of epw, got none"):
        read_archive("epw", tmp_path / "none.epw")


def test_the_clouds_of_a_station_reach_what_lies_downwind_later() -> None:
    times = pd.date_range("2024-06-15T18:00", periods=600, freq="1s", tz="UTC")
    clear = clear_ghi(times + pd.Timedelta("500ms"), PLACES)
    share = np.where((np.arange(600) >= 200) & (np.arange(600) < 260), 0.4, 1.0)
    ghi = pd.Series(clear * share, times)
    east_m = 0.01 * 111_195 * np.cos(np.deg2rad(40.0))
    moved = plant_under(ghi, PLACES, speed_m_s=10.0, from_deg=270.0)
    first_dark = [int((moved[name].to_numpy() / clear < 0.7).argmax()) for name in "abc"]
    assert first_dark[1] - first_dark[0] == pytest.approx(east_m / 10.0, abs=1.5)
    assert first_dark[2] == first_dark[0], "north of it, at the same time"
    still = plant_under(ghi, PLACES, speed_m_s=0.0, from_deg=270.0)
    assert (still["a"] == still["b"]).all()
