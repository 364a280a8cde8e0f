"""`import heliarch`: what a script or a notebook needs."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import python

import heliarch
from bus_schemas.errors import InputError

REPOSITORY = Path(__file__).parents[2]


def test_a_simulation_returns_its_summary_and_its_recording_and_prints_nothing(
    plant: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    settings = {
        "commitment.share": np.float64(0.4),
        "control.period_cycles": np.array([2, 1]),
        "control.deadlines_ms": (100, 500.0, 900),
        "title": "Sun, clouds",
    }
    run = heliarch.simulate(plant, start="12:00", end="12:00:20", settings=settings, out=out)
    assert capsys.readouterr() == ("", "")
    assert (run.summary.cycles, run.folder) == (20, out)
    assert run.summary.figures is not None
    with heliarch.open_run(run.folder) as recording:
        assert len(recording.plan.inverters) == 4
        assert "share = 0.4" in recording.scenario
        assert recording.plan.control.period_cycles == (2, 1)
        assert recording.plan.timing.tier_deadlines_ns[1] == 500_000_000


def test_a_comparison_is_a_table_with_a_row_for_each_case_scheme_and_actuator(plant: str) -> None:
    table = heliarch.compare(
        heliarch.load_scenario(plant),
        schemes=["paper", "physical-limit"],
        actuators=["fraction", "limit"],
        duration="30s",
        days=[date(2010, 4, 1)],
        seeds=np.arange(1, 2),
        settings={"commitment.share": np.array([0.3, 0.5])},
    )
    assert list(table["scheme"]) == ["paper", "paper", "physical-limit"] * 2
    assert list(table["actuator"].fillna("none")) == ["fraction", "limit", "none"] * 2
    assert list(table["commitment.share"]) == [0.3] * 3 + [0.5] * 3
    assert list(table["seed"].unique()) == [1]
    assert table["control-caused"].ge(0.0).all()
    with pytest.raises(InputError, match="actuators"):
        heliarch.compare(plant, actuators=["magic"])  # type: ignore[list-item]


def test_two_recordings_are_compared_with_their_first_difference(
    plant: str, tmp_path: Path
) -> None:
    settings = {"a": {}, "b": {"commitment.share": 0.4}}
    first, second = (
        heliarch.simulate(plant, duration="20s", settings=changes, out=tmp_path / name).folder
        for name, changes in settings.items()
    )
    found = heliarch.compare_runs(first, second)
    assert found.differences["cycle"][0] == 0
    assert found.figures.set_index("figure")["difference"]["Dispatched energy"] < 0.0
    assert "cycle" in heliarch.compare_runs(first, first).differences.columns


@pytest.mark.parametrize(
    ("bad", "named"),
    [
        ({"settings": {"no.such": 1}}, "no"),
        ({"settings": {"commitment.share": "much"}}, "share"),
        ({"scheme": "magic"}, "scheme"),
        ({"actuator": "magic"}, "actuator"),
    ],
)
def test_bad_input_is_an_input_error(plant: str, bad: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        heliarch.simulate(plant, **bad)


def test_runs_in_quick_succession_have_folders_of_their_own(
    plant: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folders = {heliarch.simulate(plant, duration="1s").folder for _ in range(3)}
    assert len(folders) == 3


def test_importing_it_loads_nothing_heavy() -> None:
    modules = python("import heliarch, sys; print(*sys.modules)").stdout.split()
    assert not {"numpy", "pandas", "zenoh"} & {name.partition(".")[0] for name in modules}
