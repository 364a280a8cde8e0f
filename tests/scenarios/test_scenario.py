"""Scenarios: what is accepted, and the one line that tells what is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from complaints import complaint_of
from own_scenarios import Folder

from bus_schemas.errors import InputError
from scenarios.run_options import RunOptions
from scenarios.scenario import load_scenario, shipped_scenarios

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
seed = 7

[commitment]
kind = "constant"
power_kw = 100

[control]
cluster_sizes = [[2, 1]]

[neighbours]
history = "earlier-day"
"""

INVERTERS = "inverter,lat,lon\na,37.100,-4.2\nb,37.101,-4.2\nc,37.102,-4.2\n"

GHI = """\
local,16,40
2024-05-12T13:00:00+02:00,500,510
2024-05-12T13:00:10+02:00,501,300
2024-05-12T13:00:20+02:00,502,200
"""


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    found = Folder(tmp_path, SCENARIO)
    found.write("plant.csv", INVERTERS)
    return found


@pytest.fixture
def measured(folder: Folder) -> Folder:
    """Two inverters under a measured sky."""
    folder.write("ghi.csv", GHI)
    folder.write("positions.csv", "station,lat,lon\n16,51.525,12.92\n40,51.526,12.93\n")
    folder.change('inverters = "plant.csv"\n', "")
    folder.change('"clouds"\nseed = 7', '"measured"\nghi = "ghi.csv"\npositions = "positions.csv"')
    folder.change("[[2, 1]]", "[[2]]")
    folder.change("earlier-day", "hindsight")
    return folder


# Good scenarios -----------------------------------------------------------------------------------


def test_a_scenario_becomes_a_plan_and_a_profile(folder: Folder) -> None:
    found = folder.prepare()
    plan, profile = found.plan, found.profile
    assert (plan.plant, plan.timing.cycles, plan.timing.lockstep) == ("small", 30, True)
    assert sorted(leaf.rpartition("/")[2] for leaf in plan.tree.leaves) == ["a", "b", "c"]
    assert (plan.tree.parents, plan.tree.rating_kw("")) == (("", "c1", "c2"), 300.0)
    assert profile.mpp_kw.shape == (30, 3)
    assert set(profile.commitment_kw.tolist()) == {100.0}
    assert not profile.regulation_kw.any(), "nothing is offered without a table"
    assert found.local_start() == "2024-05-12 13:00:00 CEST"
    assert found.remarks == ()


def test_the_command_line_may_change_time_and_pace(folder: Folder) -> None:
    found = folder.prepare(start="07:30", duration="1m", pace=2.0)
    assert found.local_start() == "2024-05-12 07:30:00 CEST"
    assert (found.plan.timing.cycles, found.plan.timing.cycle_wall_ns) == (60, 500_000_000)
    assert folder.prepare(start="2024-05-12T10:00:00Z").local_start() == "2024-05-12 12:00:00 CEST"


@pytest.mark.parametrize(
    ("start", "end", "hours"),
    [("03-31", "04-01", 23), ("05-12", "05-13", 24), ("10-27", "10-28", 25)],
)
def test_a_day_is_as_long_as_its_clocks_make_it(
    folder: Folder, start: str, end: str, hours: int
) -> None:
    folder.change("duration_s = 30", "duration_s = 60\ncycle_s = 60")
    found = folder.prepare(start=f"2024-{start}T00:00", end=f"2024-{end}T00:00")
    assert found.plan.timing.cycles == 60 * hours


def test_the_meter_corrects_with_the_scheme_that_looks_ahead_unless_the_scenario_says(
    folder: Folder,
) -> None:
    assert folder.prepare(scheme="predictive").plan.control.correction
    assert not folder.prepare(scheme="paper").plan.control.correction
    folder.change("[[2, 1]]", "[[2, 1]]\ncorrection = true")
    assert folder.prepare(scheme="paper").plan.control.correction
    folder.change("correction = true", "correction = false")
    assert not folder.prepare(scheme="predictive").plan.control.correction


@pytest.mark.parametrize(
    ("clusters", "leaves"),
    [
        ("cluster_count = [1]", "c1/a c1/b c1/c"),
        ("cluster_count = [2]", "c1/a c1/b c2/c"),
        ("cluster_count = [3, 2]", "z1/c1/a z1/c2/b z2/c3/c"),
        ("cluster_sizes = [[2, 1], [2]]", "z1/c1/a z1/c1/b z1/c2/c"),
    ],
)
def test_clusters_may_be_counted_and_tiers_are_named_by_their_letters(
    folder: Folder, clusters: str, leaves: str
) -> None:
    folder.change("cluster_sizes = [[2, 1]]", f'clusters = "listed"\n{clusters}')
    assert folder.prepare().plan.tree.leaves == tuple(leaves.split())


def test_measured_irradiance_brings_its_own_inverters(measured: Folder) -> None:
    found = measured.prepare()
    assert set(found.plan.tree.leaves) == {"c1/inv16", "c1/inv40"}
    assert found.plan.tree.rating_kw("c1/inv16") == 150.0
    assert found.profile.mpp_kw.shape == (30, 2)
    assert "neighbours were chosen" in " ".join(found.remarks)


@pytest.mark.parametrize("name", shipped_scenarios())
def test_every_shipped_scenario_loads(name: str) -> None:
    found = load_scenario(name)
    assert found.scenario.name == name
    assert found.needs_data == (name in {"hope-melpitz", "oahu-grid", "plant20mw"})


def test_probable_mistakes_are_run_with_warnings(folder: Folder) -> None:
    assert folder.prepare().remarks == ()
    folder.change("power_kw = 100", "power_kw = 301")
    folder.change("13:00:00", "01:00:00")
    folder.change("37.102", "3.7102", "plant.csv")
    expected = ("plant: expected inverters within 100 km", "time: expected", "commitment: expected")
    for warning, complaint in zip(folder.prepare().remarks, expected, strict=True):
        assert warning.startswith(f"warning: {complaint}")


# Bad scenario files -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('title = "', 'motto = "', "line 2: motto: expected the fields name, title, time, plant"),
        ("seed = 7", "seeds = 7", "line 15: irradiance.seeds: expected the fields kind, seed"),
        (
            "= 300",
            "= -3",
            "line 11: plant.rating_kw: expected number above 0 up to 10000000, got -3",
        ),
        (
            '"earlier-day"',
            '"later"',
            'line 25: neighbours.history: expected "earlier-day", "hindsight", got \'later\'',
        ),
        ('kind = "clouds"', 'kind = "moon"', 'irradiance.kind: expected "clouds" or "measured"'),
        ("sizes = [[2, 1]]", "count = [2, 3]", "control.cluster_count[1]: expected"),
        ("cluster_sizes = [[2, 1]]", "", "line 21: control.cluster_sizes"),
        ("[[2, 1]]", "[[2, 1]]\ncluster_count = [2]", "control.cluster_sizes"),
        ("[[2, 1]]", "[[2, 1], [2, 1]]", "control.cluster_sizes[1]: expected"),
        ("[[2, 1]]", "[[3, 0]]", "control.cluster_sizes[0][1]: expected whole number"),
        ("[[2, 1]]", "[[2, 1]]\nperiod_cycles = [10, 3]", "control.period_cycles[0]: expected"),
        ("2024-05-12T13:00:00", '"13:00"', "time.start: expected date and time"),
        ("Europe/Madrid", "Europe/Madird", "time.timezone: expected an IANA name"),
        ("13:00:00", "13:00", "expected TOML"),
        ("Three", "Thr\udce9", "expected TOML in UTF-8"),
        ('inverters = "plant.csv"\n', "", "plant.inverters: expected a CSV"),
        ("duration_s = 30", "duration_s = nan", "time.duration_s: expected number"),
        ("duration_s = 30", "duration_s = 30\ncycle_s = 4", "time.duration_s: expected a whole"),
        ('title = "', 'pace = 1e7\ntitle = "', "pace: expected number"),
        ('"small"', '"../x"', "line 1: name: expected a name"),
        ('[neighbours]\nhistory = "earlier-day"\n', "", "neighbours: expected table, got nothing"),
    ],
)
def test_a_bad_scenario_is_refused_with_file_and_field(
    folder: Folder, old: str, new: str, complaint: str
) -> None:
    folder.change(old, new)
    found = folder.complaint()
    assert found.startswith(f"{folder.scenario}: ")
    assert f": {complaint}" in f": {found}"


@pytest.mark.parametrize(
    ("table", "complaint"),
    [
        ("[[faults]]\nkind = 'disturbance'\nloss = 2", "line 23: faults[0].loss: expected"),
        ("[[faults]]\nloss = 0.5", "faults[0].kind: expected"),
        ("[[faults]]\nkind = 'disturbance'", "faults[0]: expected a delay"),
        ("[[orders]]\nat = 1", "orders[0]: expected either power_kw"),
        ("[[orders]]\nat = 1\nschedule = true\nhold_s = 5", "orders[0].hold_s: expected power_kw"),
        (
            "[regulation]\nkind = 'synthetic'\ncapacity_kw = 9\nfrom = '06:00:00+02:00'",
            "regulation.from: expected time of day",
        ),
        (
            "[timing.budgets]\nhop_p99_ms.production = 3",
            "timing.budgets.hop_p99_ms: expected table from telemetry",
        ),
        (
            "[timing.budgets]\nhop_p99_ms.setpoint = 0.0",
            "timing.budgets.hop_p99_ms.setpoint: expected number above 0",
        ),
    ],
)
def test_a_bad_table_is_refused_with_its_field(folder: Folder, table: str, complaint: str) -> None:
    folder.change("[control]", f"{table}\n[control]")
    assert f": {complaint}" in folder.complaint()


def test_all_wrong_fields_of_a_file_are_named_at_once_with_their_lines(folder: Folder) -> None:
    orders = "[[orders]]\nat = 1\npower_kw = -1\n[[orders]]\nat = 2\npower_kw = 'full'\n"
    folder.change("[control]", f"{orders}[control]")
    folder.change("duration_s = 30", "duration_s = 0")
    folder.change("Europe/Madrid", "Europe/Madird")  # What all fields of a table are needed for.
    folder.change('name = "small"', 'name = "s m"')
    folder.change('[neighbours]\nhistory = "earlier-day"\n', "")
    lines = folder.scenario.read_text(encoding="utf-8").splitlines()
    found = folder.complaint()
    assert len(found.splitlines()) == 1
    for field, entry in (
        ("time.duration_s", "duration_s = 0"),
        ("time.timezone", 'timezone = "Europe/Madird"'),
        ("name", 'name = "s m"'),
        ("orders[0].power_kw", "power_kw = -1"),
        ("orders[1].power_kw", "power_kw = 'full'"),
    ):
        assert f"line {lines.index(entry) + 1}: {field}: expected" in found
    assert "neighbours: expected table, got nothing" in found


@pytest.mark.parametrize(
    ("old", "new", "field", "line", "hint"),
    [
        ('title = "Three inverters under clouds"\n', "", "title", 0, "got nothing"),
        ("Europe/Madrid", "Europe/Madird", "time.timezone", 6, "an IANA name"),
        ("rating_kw = 300", "ratting_kw = 300", "plant.ratting_kw", 11, "did you mean rating_kw?"),
        ("seed = 7", 'seed = "seven"', "irradiance.seed", 15, "got 'seven'"),
        ("seed = 7", 'seed = 7\n"Global [W/m^2]" = 3', "irradiance.Global [W/m^2]", 13, "fields"),
        ('name = "small"', 'name = "PSP [W/m^2]: x"', "name", 1, "got 'PSP [W/m^2]: x'"),
    ],
)
def test_a_wrong_field_is_named_with_its_line(
    folder: Folder, old: str, new: str, field: str, line: int, hint: str
) -> None:
    folder.change(old, new)
    with pytest.raises(InputError) as caught:
        folder.prepare()
    assert caught.value.field == field
    assert caught.value.place.endswith(f": line {line}" if line else "scenario.toml")
    assert hint in caught.value.complaint


# Times --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "end", "duration", "local", "cycles"),
    [
        ("90", "120", None, "13:01:30", 30),
        (90, "2m", None, "13:01:30", 30),
        ("c90", "cycle 120", None, "13:01:30", 30),
        ("12:30", "12:31", None, "12:30:00", 60),
        (None, None, "c90", "13:00:00", 90),
        ("1m", None, 90, "13:01:00", 90),
    ],
)
def test_a_bare_number_is_seconds_and_a_cycle_is_written_as_one(
    folder: Folder,
    start: str | None,
    end: str | None,
    duration: str | None,
    local: str,
    cycles: int,
) -> None:
    found = folder.prepare(start=start, end=end, duration=duration)
    assert found.local_start() == f"2024-05-12 {local} CEST"
    assert found.plan.timing.cycles == cycles


def test_a_local_time_that_the_clocks_skip_is_refused_and_a_repeated_one_is_said(
    folder: Folder,
) -> None:
    skipped = folder.complaint(start="2024-03-31T02:30")
    assert skipped.startswith("--from: expected a local time that exists")
    folder.change("2024-05-12T13:00:00", "2024-10-27T01:00:00")
    found = folder.prepare(start="02:10")
    assert found.local_start() == "2024-10-27 02:10:00 CEST"
    assert [one for one in found.remarks if "comes twice" in one and "+0100 is the second" in one]
    second = folder.prepare(start="2024-10-27T02:10:00+01:00", end="02:11")
    assert second.plan.timing.cycles == 60, "the end is the 02:11 after the start"
    folder.change("2024-10-27T01:00:00", "2024-03-31T02:30:00")
    assert "line 5: time.start: expected a local time that exists" in folder.complaint()


@pytest.mark.parametrize("name", ["ohau", "nowhere/scenario.toml"])
def test_a_scenario_that_is_not_there_is_refused(name: str) -> None:
    complaint = complaint_of(load_scenario, name)
    assert name in complaint
    assert ("did you mean oahu" in complaint) == (name == "ohau")


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("plant.csv", "plants.csv", "plants.csv: expected it beside"),
        ("rating_kw = 300\n", "", "plant.csv: expected plant.rating_kw"),
    ],
)
def test_bad_inverters_are_refused(folder: Folder, old: str, new: str, complaint: str) -> None:
    folder.change(old, new)
    assert f"{folder.scenario}: " in folder.complaint()
    assert f": {complaint}" in f": {folder.complaint().rpartition('/')[2]}"


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        (
            "[irradiance]",
            'inverters = "12"\n[irradiance]',
            "plant.inverters, plant.grid, plant.block_m: expected",
        ),
        ("_s = 30", "_s = 30\ncycle_s = 15", "ghi.csv: expected a time.cycle_s"),
        ("hindsight", "earlier-day", "neighbours.history: expected"),
    ],
)
def test_bad_measurements_are_refused(measured: Folder, old: str, new: str, complaint: str) -> None:
    measured.change(old, new)
    found = measured.complaint()
    assert found.startswith(f"{measured.scenario}: ")
    assert complaint in found


# Options ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("option", "name", "values"),
    [
        ("duration", "duration", ("0", "soon", "745h", "9" * 400)),
        ("start", "from", ("noon", "25:00", "12:30Z", "1899-12-31", "9999-01-01")),
        ("end", "to", ("later",)),
        ("seed", "seed", (-1,)),
        ("scheme", "scheme", ("papr",)),
        ("actuator", "actuator", ("wheel",)),
        ("pace", "pace", ("soon", "0", 1e7)),
        ("devices", "device", (["c1/a=nowhere"],)),
        ("external_timeout_s", "external-timeout", (0.0,)),
        ("address", "address", ("here",)),
        ("cpus", "cpus", (["all"],)),
        ("priority", "priority", (-1, 0, 100)),
    ],
)
def test_a_bad_option_is_refused_by_its_name_without_any_scenario(
    option: str, name: str, values: tuple[object, ...]
) -> None:
    for value in values:
        complaint = complaint_of(RunOptions, **{option: value})
        assert complaint.startswith((f"--{name}: expected ", f"--{name} ")), complaint
        assert len(complaint) < 200


def test_a_time_that_the_scenario_does_not_allow_is_refused_before_its_data_is_read(
    folder: Folder,
) -> None:
    (folder.path / "plant.csv").unlink()
    assert folder.complaint(end="13:00").startswith("--to: expected a time after 13:00:00")
    assert folder.complaint(duration="1.25s").startswith("--duration: expected a whole number of")


# Regulation ---------------------------------------------------------------------------------------


def test_a_file_beside_the_scenario_is_held_onto_its_cycles(folder: Folder) -> None:
    values = np.linspace(-1.0, 1.0, 10)
    rows = [f"{13 * 3600 + 2 * row},{value}" for row, value in enumerate(values.tolist())]
    folder.write("regd.csv", "\n".join(["t_s,regd", *rows]))
    table = 'kind = "file"\npath = "regd.csv"\ncapacity_kw = 40\nto = 13:00:20'
    folder.change("[control]", f"[regulation]\n{table}\n[control]")
    found = folder.prepare()
    assert found.profile.regulation_capacity_kw == 40.0
    assert found.profile.regulation_kw.tolist() == [*np.repeat(40.0 * values, 2), *[0.0] * 10]


def test_a_place_with_one_coordinate_is_refused(folder: Folder) -> None:
    folder.change(
        '"clouds"\nseed = 7', '"dc-current"\ncurrents = "i.csv"\npositions = "p.csv"\nlat = 3'
    )
    assert "irradiance.lat: expected lon with it" in folder.complaint()
