"""`import heliarch`: what a script or a notebook needs."""

from __future__ import annotations

import re
import tomllib
import warnings
from collections.abc import Callable
from dataclasses import fields
from datetime import date, timedelta
from inspect import signature
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd
import pytest
from command_line import python
from msgspec.structs import replace
from recordings_by_hand import cut, whole_run, write_run, zero_chunk

import heliarch
from bus_schemas.errors import InputError, InputWarning
from launch_scripts.run_folder import RunFolder
from scenarios.run_options import RunOptions
from scenarios.scenario import load_scenario
from scenarios.settings import with_settings
from sim_plant.commitment import CommitmentSettings


def test_a_simulation_returns_its_summary_and_its_recording_and_prints_nothing(
    plant: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    settings = {
        "commitment.share": np.float64(0.4),
        "control.period_cycles": np.array([2, 1]),
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


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> heliarch.Run:
    """A minute of a plant whose inverters help each other."""
    out = tmp_path_factory.mktemp("runs") / "run"
    return heliarch.simulate("oahu", start="12:20", duration="60s", out=out)


@pytest.mark.parametrize("function", [heliarch.simulate, heliarch.launch, heliarch.timing])
def test_editors_and_notebooks_complete_all_options_of_a_run(
    function: Callable[..., object],
) -> None:
    named = {name: one.default for name, one in signature(function).parameters.items()}
    options = {one.name: one.default for one in fields(RunOptions)}
    del options["cycle_s"]  # That of `timing` itself.
    assert options.items() <= named.items()


def test_metrics_and_power_are_those_of_the_recording(run: heliarch.Run) -> None:
    assert run.summary.figures is not None
    assert run.metrics.dropna().to_dict() == {
        name: value for name, value in run.summary.figures.items() if value is not None
    }
    made = run.frame("production_inverters").reset_index()
    assert run.power.shape == (60, len(run.plan.inverters))
    long = made.assign(inverter=made["inverter"].astype(str)).pivot(
        index="time", columns="inverter", values="power_kw"
    )
    np.testing.assert_array_equal(run.power, long[run.power.columns])
    assert (run.power.index == long.index).all()


def test_every_table_that_export_writes_can_be_read_with_the_same_cells(
    run: heliarch.Run, tmp_path: Path
) -> None:
    summary = heliarch.export(run.folder, "parquet", out=tmp_path / "tables")
    found = run.frames(*summary.rows)
    assert {name: len(table) for name, table in found.items()} == summary.rows
    assert summary.rows["help_given"] > 0
    for name, table in found.items():
        written = pd.read_parquet(tmp_path / "tables" / f"{name}.parquet")
        for column in set(table.columns).intersection(written.columns):
            wanted = table[column].astype(written[column].dtype).to_numpy()
            np.testing.assert_array_equal(wanted, written[column].to_numpy())


def test_tables_read_together_or_in_parts_are_those_that_are_read_alone(run: heliarch.Run) -> None:
    part: dict[str, Any] = {"nodes": "c1/*", "start": 5, "end": 9}
    for name, table in run.frames("setpoint", "help_given", "missing_inputs", **part).items():
        pd.testing.assert_frame_equal(table, run.frame(name, **part))
    assert set(run.frame("setpoint", start=5, end=9)["cycle"]) == {5, 6, 7, 8}
    lengths: dict[str, Any] = {"start": timedelta(seconds=5), "end": pd.Timedelta("9s")}
    times: dict[str, Any] = {"start": run.plant.index[5], "end": run.plant.index[9]}
    for span in (lengths, times):
        assert set(run.frame("setpoint", **span)["cycle"]) == {5, 6, 7, 8}


def test_a_recording_is_verified_and_a_part_of_it_exported(
    run: heliarch.Run, tmp_path: Path
) -> None:
    found = heliarch.verify(run, nodes="c1")
    assert found.equal
    assert list(found.agents) == ["c1"]
    part = heliarch.export(run.folder, "csv", out=tmp_path / "part", signals="impp", end=3)
    assert (part.first_cycle, part.last_cycle) == (0, 2)
    unknown: Any = "xml"
    with pytest.raises(InputError, match=r"form: expected .*parquet"):
        heliarch.export(run.folder, unknown)


@pytest.mark.processes
def test_a_plant_is_launched_and_timed_and_can_be_read_in_a_program_without_a_main_guard(
    plant: str, tmp_path: Path
) -> None:
    program = f"""
import heliarch
run = heliarch.launch({plant!r}, duration="5s", out={str(tmp_path / "launched")!r})
print(run.summary.driver, run.power.shape[0], heliarch.verify(run.folder).equal)
place = {str(tmp_path / "timed")!r}
report = heliarch.timing({plant!r}, rate=10, duration="2s", out=place)
print(report.run.cycles, heliarch.timing(place).run.cycles)
run = heliarch.open_run(place)
print({example_of("stages")[0]}.columns[0])
"""
    assert python(program).stdout.split() == ["launch", "5", "True", "20", "20", "cycle"]


def test_a_fleet_is_compared_under_the_schemes_that_know_plants() -> None:
    table = heliarch.compare("fleet", duration="10s")
    assert list(table["scheme"]) == ["uncontrolled", "uniform-cap", "paper", "predictive"]


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


def test_two_recordings_are_compared_with_their_first_difference(
    plant: str, tmp_path: Path
) -> None:
    settings = {"a": {}, "b": {"commitment.share": 0.4}}
    first, second = (
        heliarch.simulate(plant, duration="20s", settings=changes, out=tmp_path / name).folder
        for name, changes in settings.items()
    )
    found = heliarch.diff(first, second)
    assert found.differences["cycle"][0] == 0
    assert found.figures.set_index("figure")["difference"]["Dispatched energy"] < 0.0
    assert "cycle" in heliarch.diff(first, first).differences.columns


def test_a_table_of_settings_changes_the_fields_that_it_names() -> None:
    oahu = load_scenario("oahu")
    share = with_settings(
        oahu, [("commitment", {"share": 0.4}), ("plant", {"delay_s": 2})]
    ).scenario
    assert share.commitment == replace(oahu.scenario.commitment, share=0.4)
    assert share.plant == replace(oahu.scenario.plant, delay_s=2.0)
    other = {"kind": "constant", "power_kw": 5}
    assert with_settings(oahu, [("commitment", other)]).scenario.commitment == msgspec.convert(
        other, CommitmentSettings
    )


def test_importing_it_loads_nothing_heavy() -> None:
    modules = python("import heliarch, sys; print(*sys.modules)").stdout.split()
    assert not {"numpy", "pandas", "zenoh"} & {name.partition(".")[0] for name in modules}


def test_a_damaged_recording_is_named_where_it_is_read_without_a_with_block(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap", whole_run(90), messages_per_chunk=100)
    chunk = zero_chunk(tmp_path / "run.mcap", 5)
    run = heliarch.open_run(tmp_path)
    with pytest.warns(InputWarning, match=f"chunk at byte {chunk.offset:,}"):
        assert len(run.frame("impp", nodes="c1/a")) < 90
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # It has been said.
        run.frame("impp", nodes="c1/a")


@pytest.fixture(scope="module")
def oahu(tmp_path_factory: pytest.TempPathFactory) -> heliarch.Run:
    return heliarch.simulate("oahu", duration="30s", out=tmp_path_factory.mktemp("api") / "oahu")


def example_of(name: str) -> list[str]:
    return re.findall(r"`([^`]*\brun\.[^`]*)`", getattr(heliarch.Run, name).__doc__ or "")


OF_ANY_RUN = {name for name in dir(heliarch.Run) if name[0] != "_"} - {"close", "stages"}


@pytest.mark.parametrize("name", sorted(OF_ANY_RUN))
def test_what_a_run_has_shows_an_example_that_runs(oahu: heliarch.Run, name: str) -> None:
    assert example_of(name)
    for example in example_of(name):
        eval(example, {"run": oahu, "tomllib": tomllib})


def test_units_are_beside_a_table_and_in_its_header_on_request(oahu: heliarch.Run) -> None:
    frame = oahu.frame("dispatch")
    assert frame.attrs["units"]["power_kw"] == "kW"
    assert frame.attrs["units"]["order_ramp_kw_per_min"] == "kW/min"
    assert "cycle" not in frame.attrs["units"]
    assert {"cycle", "power [kW]", "order_hold [s]"} <= set(heliarch.with_units(frame).columns)
    assert "c2/inv07 [kW]" in heliarch.with_units(oahu.power)
    assert "power_kw" in frame


def test_a_recording_that_was_cut_is_named_as_it_is_opened(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap", whole_run(90), messages_per_chunk=100)
    cut(tmp_path / "run.mcap")
    with pytest.warns(InputWarning, match="a part of the run is missing"):
        heliarch.open_run(tmp_path)


def test_a_warning_points_at_the_users_line(
    plant: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(folder: RunFolder, summary: bytes) -> None:
        raise OSError("No space left on device")

    monkeypatch.setattr(RunFolder, "write_summary", refuse)
    with pytest.warns(InputWarning, match="No space") as found:
        heliarch.simulate(plant, duration="3", out=tmp_path / "run")
    assert [one.filename for one in found if one.category is InputWarning] == [__file__]


def test_a_run_shows_its_figures_and_the_plants_powers(run: heliarch.Run) -> None:
    assert run.plan.run_id in repr(run)
    assert f"{run.metrics['control-caused']:.3f} %" in repr(run)
    page = run._repr_html_()
    assert "Satisfied commitment" in page
    assert "<pre>available" in page
    assert run.metrics.attrs["units"]["control-caused"] == "% of dispatch"
    for table in (run.plant, run.power):
        assert set(table.attrs["units"].values()) == {"kW"}
    assert "nan" not in page
    plant = run.plant
    assert len(plant) == 60
    assert plant.delivered_kw.to_numpy() == pytest.approx(run.power.sum(axis=1).to_numpy())
    short = (plant.dispatch_kw - plant.delivered_kw).clip(lower=0.0)
    assert plant.shortfall_kw.to_numpy() == pytest.approx(short.to_numpy())
    assert len([name for name in dir(run) if not name.startswith("_")]) <= 15


@pytest.mark.parametrize(
    ("bad", "named"),
    [
        ({"settings": {"no.such": 1}}, r"^settings no\.such=1: no"),
        ({"faults": "kill"}, "^faults kill: expected"),
        ({"end": "12:30", "duration": 5}, "^end: expected no second length"),
        ({"colour": 1}, "^options: expected one of"),
    ],
)
def test_bad_input_is_an_input_error(plant: str, bad: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        heliarch.simulate(plant, **bad)


@pytest.mark.parametrize(
    "bad",
    [
        {"actuators": "magic"},
        {"seeds": ["x"]},
        {"days": "yesterday"},
        {"workers": 0},
        {"schemes": "magic"},
        {"settings": {"no.such": 1}},
    ],
)
def test_a_comparison_names_the_parameter_that_is_wrong(plant: str, bad: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=rf"^{next(iter(bad))}"):
        heliarch.compare(plant, **bad)


def test_reading_names_the_parameter_that_is_wrong(run: heliarch.Run) -> None:
    with pytest.raises(InputError, match=r"^nodes: expected"):
        run.frame("impp", nodes="zz")
