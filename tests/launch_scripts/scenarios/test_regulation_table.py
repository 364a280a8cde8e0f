"""The table `[regulation]` of a scenario: what it makes of a run, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bus_schemas.errors import InputError
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario

SCENARIO = """\
name = "small"
title = "Three inverters under clouds"

[time]
start = 2024-05-12T13:00:00
timezone = "Europe/Madrid"
duration_s = 30

[plant]
inverters = "plant.csv"
rating_kw = 300

[irradiance]
kind = "clouds"

[commitment]
kind = "constant"
power_kw = 100

[control]
cluster_sizes = [[2, 1]]

[neighbours]
history = "earlier-day"
"""

INVERTERS = "inverter,lat,lon\na,37.100,-4.2\nb,37.101,-4.2\nc,37.102,-4.2\n"

ONE_O_CLOCK_S = 13 * 3600


def prepared(folder: Path, regulation: str) -> Preparation:
    path = folder / "small.toml"
    path.write_text(f"{SCENARIO}\n{regulation}", encoding="utf-8")
    (folder / "plant.csv").write_text(INVERTERS, encoding="utf-8")
    return prepare(load_scenario(str(path)), RunOptions(), "a-run")


def test_a_scenario_without_the_table_has_no_regulation(tmp_path: Path) -> None:
    profile = prepared(tmp_path, "").profile
    assert profile.regulation_capacity_kw == 0.0
    assert profile.regulation_kw.tolist() == [0.0] * 30


def test_a_file_beside_the_scenario_is_held_onto_its_cycles(tmp_path: Path) -> None:
    values = np.linspace(-1.0, 1.0, 10)
    rows = [f"{ONE_O_CLOCK_S + 2 * row},{value}" for row, value in enumerate(values.tolist())]
    (tmp_path / "regd.csv").write_text("\n".join(["t_s,regd", *rows]), encoding="utf-8")
    found = prepared(
        tmp_path,
        '[regulation]\nkind = "file"\npath = "regd.csv"\ncapacity_kw = 40\nto = 13:00:20',
    )
    assert found.profile.regulation_capacity_kw == 40.0
    assert found.profile.regulation_kw.tolist() == [*np.repeat(40.0 * values, 2), *[0.0] * 10]


def test_a_synthetic_signal_needs_no_file(tmp_path: Path) -> None:
    found = prepared(tmp_path, '[regulation]\nkind = "synthetic"\ncapacity_kw = 40\nseed = 5')
    regulation_kw = found.profile.regulation_kw
    assert 0.0 < np.abs(regulation_kw).max() <= 40.0
    np.testing.assert_array_equal(regulation_kw[::2], regulation_kw[1::2])


@pytest.mark.parametrize(
    ("regulation", "place"),
    [
        ('kind = "synthetic"\ncapacity_kw = -1.0', "small.toml: regulation.capacity_kw"),
        (
            'kind = "synthetic"\ncapacity_kw = 1\nfrom = 09:00:00\nto = 09:00:00',
            "small.toml: regulation.from, regulation.to",
        ),
        ('kind = "file"\npath = "regd.csv"\ncapacity_kw = 1', "regd.csv"),
    ],
)
def test_a_bad_table_is_refused_with_file_and_field(
    tmp_path: Path, regulation: str, place: str
) -> None:
    with pytest.raises(InputError, match=f"^{tmp_path / place}: expected"):
        prepared(tmp_path, f"[regulation]\n{regulation}")


def test_a_signal_of_another_step_than_pjms_is_taken_and_told(tmp_path: Path) -> None:
    rows = [f"{ONE_O_CLOCK_S + 4 * row},0.5" for row in range(10)]
    (tmp_path / "slow.csv").write_text("\n".join(["t_s,regd", *rows]), encoding="utf-8")
    table = '[regulation]\nkind = "file"\npath = "slow.csv"\ncapacity_kw = 40'
    assert prepared(tmp_path, table).remarks == (
        "slow.csv: a value every 4 s, PJM sends one every 2 s: each is held until the next.",
    )
