"""Regulation asked of a plant: from a file or synthetic, held onto the cycles of a run."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest
from complaints import complaint_of

from sim_plant.regulation import RegulationSettings, SyntheticRegulation, regulation_kw
from sim_plant.synthetic_regd import synthetic_regd

HONOLULU = "Pacific/Honolulu"
CAPACITY_KW = 500.0
VALUES = (0.0, 0.5, -1.0, 1.0, 0.25)
"""A value every 2 s."""

HELD_KW = CAPACITY_KW * np.repeat(VALUES, 2)


def read(toml: str) -> RegulationSettings:
    settings: RegulationSettings = msgspec.toml.decode(toml, type=RegulationSettings)
    return settings


def cycles(start: str, count: int, cycle_s: float = 1.0) -> pd.DatetimeIndex:
    """Return cycles from a local time on Oahu on."""
    first = pd.Timestamp(start, tz=HONOLULU).tz_convert("UTC")
    return pd.date_range(first, periods=count, freq=pd.Timedelta(seconds=cycle_s), unit="ns")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "signal.csv"


def write(path: Path, first_s: int = 0, values: tuple[float, ...] = VALUES) -> None:
    rows = [f"{first_s + 2 * row},{value}" for row, value in enumerate(values)]
    path.write_text("\n".join(["t_s,regd", *rows]) + "\n", encoding="utf-8")


def asked_kw(
    path: Path, times: pd.DatetimeIndex, toml: str = "", timezone: str = HONOLULU
) -> list[float]:
    settings = read(f'kind = "file"\npath = "{path.name}"\ncapacity_kw = {CAPACITY_KW}\n{toml}')
    found, _ = regulation_kw(settings, times, timezone, path.parent.joinpath)
    return list(found.tolist())


def complaint(path: Path, times: pd.DatetimeIndex | None = None, toml: str = "") -> str:
    return complaint_of(asked_kw, path, cycles("2010-04-01", 1) if times is None else times, toml)


@pytest.mark.parametrize(
    ("cycle_s", "expected"),
    [
        (1.0, np.repeat(VALUES, 2)),
        (0.5, np.repeat(VALUES, 4)),
        (2.0, VALUES),
        (3.0, [0.0, 0.5, 1.0]),  # in force at 0, 3 and 6 s
    ],
)
def test_a_cycle_of_any_length_takes_the_value_in_force_at_its_beginning(
    path: Path, cycle_s: float, expected: list[float]
) -> None:
    write(path)
    found = asked_kw(path, cycles("2010-04-01", len(expected), cycle_s))
    assert found == (CAPACITY_KW * np.array(expected)).tolist()


@pytest.mark.parametrize(
    ("first_s", "start", "toml", "expected_kw"),
    [
        (9 * 3600, "09:00:03", "", HELD_KW[3:]),
        (1000, "00:00:02", "signal_midnight_s = 1000.0", HELD_KW[2:]),
        # The signal ends at 09:00:10, within the run, but no longer offered.
        (
            9 * 3600,
            "08:59:58",
            "from = 09:00:00\nto = 09:00:06",
            [0.0, 0.0, *HELD_KW[:6], *[0.0] * 12],
        ),
        (86_394, "23:59:54", "from = 23:59:56\nto = 00:00:02", [0.0, 0.0, *HELD_KW[2:8], 0.0, 0.0]),
        (0, "20:00:00", "from = 09:00:00\nto = 17:00:00", [0.0] * 3),
    ],
    ids=["clock", "shifted", "while offered", "over midnight", "outside the offer"],
)
def test_a_run_takes_the_signal_of_its_clock_while_it_is_offered(
    path: Path, first_s: int, start: str, toml: str, expected_kw: list[float]
) -> None:
    if first_s:  # A run outside the offer does not need the file.
        write(path, first_s)
    assert asked_kw(path, cycles(f"2010-04-01T{start}", len(expected_kw)), toml) == list(
        expected_kw
    )


def test_a_synthetic_signal_does_not_depend_on_where_the_run_begins() -> None:
    settings = read('kind = "synthetic"\ncapacity_kw = 500\nseed = 3')
    assert settings == SyntheticRegulation(capacity_kw=500.0, seed=3)
    day, _ = regulation_kw(settings, cycles("2010-04-01", 86_400), HONOLULU, Path)
    part, _ = regulation_kw(settings, cycles("2010-04-01T12:00:01", 60), HONOLULU, Path)
    np.testing.assert_array_equal(part, day[43_201:43_261])
    np.testing.assert_array_equal(day[::2], day[1::2])
    assert np.abs(day).max() == 500.0
    # 14,700 days since 1970
    np.testing.assert_array_equal(day[::2], 500.0 * synthetic_regd(3).reshape(40, -1)[14_700 % 40])


@pytest.mark.parametrize("header", ["t_s,regd,rega", "regd"])
def test_a_header_other_than_two_names_is_refused(path: Path, header: str) -> None:
    row = ",".join(["0"] * (header.count(",") + 1))
    path.write_text(f"{header}\n{row}\n{row}\n", encoding="utf-8")
    assert complaint(path).startswith("signal.csv: line 1: expected")


@pytest.mark.parametrize(("first_s", "count"), [(1, 5), (0, 11)])
def test_a_signal_that_does_not_cover_the_run_is_refused(
    path: Path, first_s: int, count: int
) -> None:
    write(path, first_s)
    assert complaint(path, cycles("2010-04-01", count)).startswith("signal.csv: expected a signal")


def test_the_offer_keeps_to_the_clock_when_it_is_set_forward(path: Path) -> None:
    # 2024-03-31 in Madrid: after 01:59:59 comes 03:00:00
    write(path, first_s=3 * 3600)
    times = pd.date_range("2024-03-31T00:59:58Z", periods=6, freq="1s", unit="ns")
    found = asked_kw(path, times, "from = 03:00:00\nto = 04:00:00", "Europe/Madrid")
    assert found == [0.0, 0.0, *HELD_KW[:4]]
