"""Scenarios: what is accepted, and the one line that tells what is not."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from complaints import complaint_of
from own_scenarios import Folder

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

MEASURED = """\
name = "field"
title = "Two inverters under a measured sky"

[time]
start = 2013-09-08T09:15:00
timezone = "UTC"
duration_s = 4

[plant]
rating_kw = 200

[irradiance]
kind = "measured"
ghi = "ghi.csv"
positions = "positions.csv"

[commitment]
kind = "constant"
power_kw = 50

[control]
cluster_sizes = [[2]]

[neighbours]
history = "hindsight"
"""

GHI = """\
utc,16,40
2013-09-08T09:15:00Z,500,510
2013-09-08T09:15:01Z,501,300
2013-09-08T09:15:02Z,502,200
2013-09-08T09:15:03Z,503,400
"""

POSITIONS = "station,lat,lon\n16,51.525,12.92\n40,51.526,12.93\n"


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    found = Folder(tmp_path, SCENARIO)
    found.write("plant.csv", INVERTERS)
    return found


@pytest.fixture
def measured(folder: Folder) -> Folder:
    folder.write("scenario.toml", MEASURED)
    folder.write("ghi.csv", GHI)
    folder.write("positions.csv", POSITIONS)
    return folder


# Good scenarios -----------------------------------------------------------------------------------


def test_a_scenario_becomes_a_plan_and_a_profile(folder: Folder) -> None:
    found = folder.prepare()
    assert found.plan.plant == "small"
    assert found.plan.timing.cycles == 30
    assert sorted(leaf.rpartition("/")[2] for leaf in found.plan.tree.leaves) == ["a", "b", "c"]
    assert found.plan.tree.parents == ("", "c1", "c2")
    assert found.plan.tree.rating_kw("") == 300.0
    assert found.profile.mpp_kw.shape == (30, 3)
    assert set(found.profile.commitment_kw.tolist()) == {100.0}
    assert not found.profile.regulation_kw.any(), "nothing is offered without a table"
    assert found.local_start() == "2024-05-12 13:00:00 CEST"
    assert found.plan.timing.lockstep
    assert not found.hindsight


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


def test_a_file_may_begin_with_a_byte_order_mark(folder: Folder) -> None:
    text = folder.scenario.read_text(encoding="utf-8")
    folder.scenario.write_text(text, encoding="utf-8-sig")
    assert folder.prepare().plan.plant == "small"


def test_a_cycle_too_short_for_any_clock_is_refused(folder: Folder) -> None:
    assert folder.prepare(pace=10_000.0).plan.timing.cycle_wall_ns == 100_000
    complaint = folder.complaint(pace=20_000.0)
    assert complaint.startswith("--pace 20000: expected cycles of 100 us or more")


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
    assert found.plan.tree.rating_kw("c1/inv16") == 100.0
    assert found.profile.mpp_kw.shape == (4, 2)
    assert found.hindsight


@pytest.mark.parametrize("name", shipped_scenarios())
def test_every_shipped_scenario_loads(name: str) -> None:
    found = load_scenario(name)
    assert found.scenario.name == name
    assert found.needs_data == (name in {"hope-melpitz", "oahu-grid", "plant20mw"})


@pytest.mark.parametrize(
    ("old", "new", "name", "complaint"),
    [
        ("power_kw = 100", "power_kw = 301", "scenario.toml", "commitment: expected"),
        ("13:00:00", "01:00:00", "scenario.toml", "time: expected"),
        (
            "37.102",
            "3.7102",
            "plant.csv",
            "plant: expected inverters within 100 km of its middle, got c",
        ),
    ],
)
def test_a_probable_mistake_is_run_with_a_warning(
    folder: Folder, old: str, new: str, name: str, complaint: str
) -> None:
    assert folder.prepare().remarks == ()
    folder.change(old, new, name)
    (warning,) = folder.prepare().remarks
    assert warning.startswith(f"warning: {complaint}")


# Bad scenario files -------------------------------------------------------------------------------

DISTURBANCE = "[[faults]]\nkind = 'disturbance'\n"
BUDGETS = "[timing.budgets]\n"
SYNTHETIC = '[regulation]\nkind = "synthetic"\n'


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        (
            "rating_kw",
            "rating_mw",
            "line 11: plant.rating_mw: expected the fields inverters, grid, rating",
        ),
        ('title = "', 'motto = "', "line 2: motto: expected the fields name, title, time, plant"),
        ("seed = 7", "seeds = 7", "line 15: irradiance.seeds: expected the fields kind, seed"),
        (
            "rating_kw = 300",
            "rating_kw = -300",
            "line 11: plant.rating_kw: expected number above 0 up to 10000000, got -300",
        ),
        (
            'history = "earlier-day"',
            'history = "later"',
            'line 25: neighbours.history: expected "earlier-day", "hindsight", got \'later\'',
        ),
        ('kind = "clouds"', 'kind = "moon"', 'irradiance.kind: expected "clouds" or "measured"'),
        ("sizes = [[2, 1]]", "count = [2, 3]", "control.cluster_count[1]: expected"),
        ("cluster_sizes = [[2, 1]]", "", "line 21: control.cluster_sizes"),
        ("[[2, 1]]", "[[2, 1]]\ncluster_count = [2]", "control.cluster_sizes"),
        ("[[2, 1]]", "[[2, 1], [2, 1]]", "control.cluster_sizes[1]: expected"),
        ("[[2, 1]]", "[[3, 0]]", "control.cluster_sizes[0][1]: expected whole number"),
        ("[[2, 1]]", "[[2, 1]]\nperiod_cycles = [10, 5, 1]", "control.period_cycles: expected"),
        ("[[2, 1]]", "[[2, 1]]\nperiod_cycles = [10, 3]", "control.period_cycles[0]: expected"),
        ("2024-05-12T13:00:00", '"13:00"', "time.start: expected date and time"),
        ("Europe/Madrid", "Europe/Madird", "time.timezone: expected an IANA name"),
        ("13:00:00", "13:00", "expected TOML"),
        ("Three", "Thr\udce9", "expected TOML in UTF-8"),
        ('inverters = "plant.csv"\n', "", "plant.inverters: expected a CSV"),
        ("duration_s = 30", "duration_s = nan", "time.duration_s: expected number"),
        ("duration_s = 30", "duration_s = 30\ncycle_s = 4", "time.duration_s: expected a whole"),
        ("seed = 7", "clouds.cloud_cover = nan", "irradiance.clouds.cloud_cover: expected"),
        ('title = "', 'pace = 1e7\ntitle = "', "pace: expected number"),
        ('"small"', '"../x"', "line 1: name: expected a name"),
        ('[neighbours]\nhistory = "earlier-day"\n', "", "neighbours: expected table, got nothing"),
        (
            "[control]",
            "[[faults]]\nkind = 'disturbance'\nloss = 2\n[control]",
            "line 23: faults[0].loss: expected",
        ),
        ("[control]", "[[faults]]\nloss = 0.5\n[control]", "faults[0].kind: expected"),
        ("[control]", f"{DISTURBANCE}[control]", "faults[0]: expected a delay"),
        ("[control]", "[[orders]]\nat = 1\n[control]", "orders[0]: expected either power_kw"),
        (
            "[control]",
            "[[orders]]\nat = 1\nschedule = true\nhold_s = 5\n[control]",
            "orders[0].hold_s: expected power_kw with it",
        ),
        (
            "[control]",
            f"{SYNTHETIC}capacity_kw = 9\nfrom = '06:00:00+02:00'\n[control]",
            "regulation.from: expected time of day",
        ),
        (
            "[control]",
            f"{BUDGETS}hop_p99_ms.production = 3\n[control]",
            "timing.budgets.hop_p99_ms: expected table from telemetry",
        ),
        (
            "[control]",
            f"{BUDGETS}hop_p99_ms.setpoint = 0.0\n[control]",
            "timing.budgets.hop_p99_ms.setpoint: expected number",
        ),
    ],
)
def test_a_bad_scenario_is_refused_with_file_and_field(
    folder: Folder, old: str, new: str, complaint: str
) -> None:
    folder.change(old, new)
    found = folder.complaint()
    assert found.startswith(f"{folder.scenario}: ")
    assert f": {complaint}" in f": {found}"


def test_all_wrong_fields_are_named_at_once_each_with_its_line(folder: Folder) -> None:
    folder.change('title = "Three inverters under clouds"\n', "")
    folder.change("Europe/Madrid", "Europe/Madird")
    folder.change("rating_kw = 300", "ratting_kw = 300")
    folder.change("seed = 7", 'seed = "seven"')
    complaint = folder.complaint()
    assert re.findall(r"((?:line \d+: )?[\w.]+): expected", complaint) == [
        "title",
        "line 5: time.timezone",
        "line 10: plant.ratting_kw",
        "line 14: irradiance.seed",
    ]
    assert "did you mean rating_kw?" in complaint


@pytest.mark.parametrize("name", ["ohau", "nowhere/scenario.toml"])
def test_a_scenario_that_is_not_there_is_refused(name: str) -> None:
    complaint = complaint_of(load_scenario, name)
    assert name in complaint
    assert ("did you mean oahu" in complaint) == (name == "ohau")


@pytest.mark.parametrize(
    ("scenario", "old", "new", "complaint"),
    [
        (SCENARIO, "plant.csv", "plants.csv", "plants.csv: expected it beside"),
        (SCENARIO, '"plant.csv"', '""', "{}: expected"),
        (SCENARIO, "rating_kw = 300\n", "", "plant.csv: expected plant.rating_kw"),
        (MEASURED, "[irradiance]", 'inverters = "12"\n[irradiance]', "plant.inverters"),
        (MEASURED, "_s = 4", "_s = 3\ncycle_s = 1.5", "{}/ghi.csv: expected a time.cycle_s"),
        (MEASURED, "hindsight", "earlier-day", "neighbours.history: expected"),
    ],
)
def test_bad_inverters_and_measurements_are_refused(
    measured: Folder, scenario: str, old: str, new: str, complaint: str
) -> None:
    measured.write("scenario.toml", scenario)
    measured.change(old, new)
    found = measured.complaint()
    assert found.startswith(f"{measured.scenario}: ")
    assert f": {complaint.format(measured.path)}" in found


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
        ("faults", "fault", (["delay=50"],)),
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

ONE_O_CLOCK_S = 13 * 3600


def test_a_file_beside_the_scenario_is_held_onto_its_cycles(folder: Folder) -> None:
    values = np.linspace(-1.0, 1.0, 10)
    rows = [f"{ONE_O_CLOCK_S + 2 * row},{value}" for row, value in enumerate(values.tolist())]
    folder.write("regd.csv", "\n".join(["t_s,regd", *rows]))
    table = 'kind = "file"\npath = "regd.csv"\ncapacity_kw = 40\nto = 13:00:20'
    folder.change("[control]", f"[regulation]\n{table}\n[control]")
    found = folder.prepare()
    assert found.profile.regulation_capacity_kw == 40.0
    assert found.profile.regulation_kw.tolist() == [*np.repeat(40.0 * values, 2), *[0.0] * 10]
