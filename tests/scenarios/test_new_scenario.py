"""`heliarch init`: whatever the stations, steps and clocks, what it writes runs at once."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus_schemas.errors import InputError
from scenarios.new_scenario import measured_scenario
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import MeasuredIrradiance, load_scenario
from sim_plant.clear_sky import clear_ghi
from sim_plant.irradiance import StatedForm

PLACE = (47.4, 8.5)
ZONES = ("UTC", "Europe/Berlin", "Asia/Kathmandu", "Pacific/Honolulu", "+05:29", "-09:30")
BEGINS = (
    "2024-02-29T10:00",
    "2024-03-31T00:00",  # Clocks of Europe go forward, and back in October.
    "2024-10-27T00:00",
    "2024-06-15T22:30",
    "2024-12-31T21:30",
)
NAMES = st.text(
    st.characters(exclude_categories=("Cs", "Cc", "Zs", "Zl", "Zp")) | st.just(" "), max_size=20
).map(lambda name: f"s{name}".strip())


def written(
    folder: Path,
    names: list[str],
    begin: str,
    step_s: int,
    zone: str,
    place: tuple[float, float] = PLACE,
    rows: int = 40,
    lacking: int = 0,
) -> tuple[Path, list[str]]:
    """Write both files, make the scenario and prepare it; return its path and the remarks."""
    times = pd.date_range(begin, periods=rows, freq=pd.Timedelta(seconds=step_s), tz="UTC")
    where = pd.DataFrame({"lat": [place[0]], "lon": [place[1]]})
    sky = 0.9 * clear_ghi(times, where)
    text = io.StringIO()
    write = csv.writer(text)
    write.writerow(["time", *names])
    for at, (time, value) in enumerate(zip(times, sky, strict=True)):
        if not 10 <= at < 10 + lacking:
            values = [f"{value * (1.0 + 0.01 * each):.2f}" for each in range(len(names))]
            write.writerow([stamp_of(time, zone), *values])
    (folder / "ghi.csv").write_text(text.getvalue(), encoding="utf-8")
    positions = io.StringIO()
    rows_of = csv.writer(positions)
    rows_of.writerow(["station", "lat", "lon"])
    rows_of.writerows([name, place[0] + 0.001 * at, place[1]] for at, name in enumerate(names))
    (folder / "positions.csv").write_text(positions.getvalue(), encoding="utf-8")
    out = folder / "plant.toml"
    scenario, _, remarks = measured_scenario(
        folder / "positions.csv", folder / "ghi.csv", out, StatedForm()
    )
    out.write_text(scenario, encoding="utf-8")
    found = prepare(load_scenario(str(out)), RunOptions(), "test")
    assert found.plan.timing.cycles >= 1
    assert len(found.plan.tree.leaves) == len(names)
    return out, remarks


def stamp_of(time: pd.Timestamp, zone: str) -> str:
    """Return a time with the offset of a zone, or of a zone `+05:29`."""
    if zone[0] not in "+-":
        return time.tz_convert(zone).isoformat()
    hours, minutes = zone[1:].split(":")
    sign = 1 if zone[0] == "+" else -1
    since = pd.Timedelta(hours=int(hours), minutes=int(minutes))
    return f"{(time.tz_localize(None) + sign * since).isoformat()}{zone}"


@settings(max_examples=15, deadline=None)
@given(
    names=st.lists(NAMES, min_size=1, max_size=4, unique=True),
    begin=st.sampled_from(BEGINS),
    step_s=st.sampled_from([1, 7, 10, 29, 60, 300, 900, 1740, 3600]),
    zone=st.sampled_from(ZONES),
    lacking=st.integers(0, 3),
)
def test_the_new_scenario_runs_at_once(
    names: list[str], begin: str, step_s: int, zone: str, lacking: int
) -> None:
    with TemporaryDirectory() as folder:
        written(Path(folder), names, begin, step_s, zone, lacking=lacking)


@pytest.mark.parametrize("lat", [78.2, -77.8, 89.9])
@pytest.mark.parametrize("begin", ["2024-06-21T00:00", "2024-12-21T00:00"])
def test_polar_day_and_polar_night_run_too(tmp_path: Path, lat: float, begin: str) -> None:
    written(tmp_path, ["a", "b"], begin, 600, "UTC", place=(lat, 15.6), rows=144)


@pytest.mark.parametrize(
    ("station", "inverter"),
    [("Global PSP [W/m^2]", "invGlobal-PSP-W-m-2"), ("a/b", "inva-b"), ("p [1]", "invp-1")],
)
def test_the_names_of_stations_are_kept_and_those_of_inverters_are_made_from_them(
    tmp_path: Path, station: str, inverter: str
) -> None:
    out, _ = written(tmp_path, [station, "p2"], "2024-06-15T11:00", 10, "UTC")
    found = load_scenario(str(out))
    irradiance = found.scenario.irradiance
    assert isinstance(irradiance, MeasuredIrradiance)
    assert irradiance.stations == (station, "p2")
    leaves = prepare(found, RunOptions(), "test").plan.tree.leaves
    assert inverter in {leaf.rpartition("/")[2] for leaf in leaves}


# Plausibility -------------------------------------------------------------------------------------


def doubts(folder: Path, ghi: pd.DataFrame, lat: float = 35.05, lon: float = -106.5) -> str:
    """Return the warnings on a day of irradiance."""
    return remarks_on(folder, ghi, "warning: ghi.csv", lat, lon)


def remarks_on(
    folder: Path, ghi: pd.DataFrame, begin: str, lat: float = 35.05, lon: float = -106.5
) -> str:
    """Return what is said of irradiance in lines that begin so."""
    ghi.round(2).to_csv(folder / "ghi.csv", index_label="time")
    lines = (f"{name},{lat + 0.001 * at},{lon}" for at, name in enumerate(ghi.columns))
    positions = "\n".join(["station,lat,lon", *lines, ""])
    (folder / "positions.csv").write_text(positions, encoding="utf-8")
    files = folder / "positions.csv", folder / "ghi.csv"
    _, _, remarks = measured_scenario(*files, folder / "plant.toml", StatedForm(stamps="begin"))
    return "; ".join(one for one in remarks if one.startswith(begin))


def a_day(lat: float = 35.05, lon: float = -106.5) -> pd.DataFrame:
    """Three stations on a bright day with clouds of their own."""
    times = pd.date_range("2024-06-15T07:00", periods=288, freq="5min", tz="UTC")
    place = pd.DataFrame({"lat": [lat], "lon": [lon]})
    clear = clear_ghi(times, place)[:, None]
    clouds = np.random.default_rng(4).uniform(0.7, 1.0, (288, 3))
    return pd.DataFrame(clear * clouds, times, ["p1", "p2", "p3"])


def test_local_times_with_z_and_swapped_coordinates_are_seen(tmp_path: Path) -> None:
    local = a_day().shift(freq="-6h")
    assert "are these local times?" in doubts(tmp_path, local.iloc[140:180])
    with pytest.raises(InputError, match="whose offset from UTC is right"):
        doubts(tmp_path, local)
    swapped = a_day(lat=10.0, lon=50.0).iloc[:50]
    assert "are latitude and longitude swapped?" in doubts(tmp_path, swapped, lat=50.0, lon=10.0)


def test_stuck_dead_shaded_and_twin_sensors_are_named(tmp_path: Path) -> None:
    ghi = a_day()
    ghi.iloc[120:160, 0] = 512.0
    assert "p1 shows 512 W/m2 for 200 min: stuck?" in doubts(tmp_path, ghi)
    assert "p2 shows 0.0 W/m2 on average" in doubts(tmp_path, a_day().assign(p2=0.0))
    shaded = a_day().assign(p3=lambda day: 0.4 * day["p3"])
    assert "p3 has 4" in doubts(tmp_path, shaded)
    twins = a_day().assign(p2=lambda day: day["p1"], p4=lambda day: day["p1"])
    assert doubts(tmp_path, twins).count("equal") == 1
    assert "p1, p2, p4 are equal" in doubts(tmp_path, twins)


@pytest.mark.parametrize(
    ("rows", "offset_h", "said"),
    [
        (slice(None), -7, "fits Etc/GMT+7 best"),
        (slice(None), -6, "fits Etc/GMT+6 best"),
        (slice(None), 0, "fits UTC best"),
        (slice(144, 147), -6, "from these 10 min; assumed Etc/GMT+7"),
        (slice(100, 160), -6, "from these 295 min; assumed Etc/GMT+7"),
    ],
)
def test_a_zone_is_by_the_suns_path_only_where_that_tells_it(
    tmp_path: Path, rows: slice, offset_h: int, said: str
) -> None:
    ghi = a_day().iloc[rows].shift(freq=f"{offset_h}h").tz_localize(None)
    assert said in remarks_on(tmp_path, ghi, "--timezone was not given")


def test_a_column_without_a_name_is_not_said_to_be_left_out(tmp_path: Path) -> None:
    written(tmp_path, ["p1", "p2"], "2024-06-15T11:00", 10, "UTC")
    ghi = tmp_path / "ghi.csv"
    ghi.write_text(ghi.read_text().replace("\n", ",\n"), encoding="utf-8")
    files = tmp_path / "positions.csv", ghi
    _, _, remarks = measured_scenario(*files, tmp_path / "plant.toml", StatedForm())
    assert not [one for one in remarks if one.startswith("left out")]
