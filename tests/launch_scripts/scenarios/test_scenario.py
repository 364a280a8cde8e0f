"""Scenarios: what is accepted, and the one line that tells what is not."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bus_schemas.errors import InputError
from launch_scripts.cli import app
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario, parse_duration_s, shipped_scenarios

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

DURATIONS = "accepted are seconds above 0, or 90s, 15m, 1h30m, at most 31 days"
STARTS = "accepted is a local time such as 12:30 or 2010-04-01T12:30:00, 1900 to 2200"

POSITIONS = "station,lat,lon\n16,51.525,12.92\n40,51.526,12.93\n"


class Folder:
    """A folder with a scenario and its data, in which one thing is changed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.scenario = path / "scenario.toml"
        self.write("scenario.toml", SCENARIO)
        self.write("plant.csv", INVERTERS)

    def write(self, name: str, text: str) -> None:
        (self.path / name).write_text(text, encoding="utf-8")

    def change(self, old: str, new: str, name: str = "scenario.toml") -> None:
        text = (self.path / name).read_text(encoding="utf-8")
        assert old in text
        self.write(name, text.replace(old, new))

    def prepare(self, **options: object) -> Preparation:
        scenario = load_scenario(str(self.scenario))
        return prepare(scenario, RunOptions(**options), "by-hand")  # type: ignore[arg-type]

    def complaint(self, **options: object) -> str:
        with pytest.raises(InputError) as caught:
            self.prepare(**options)
        message = str(caught.value)
        assert "\n" not in message
        return message


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    return Folder(tmp_path)


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
    assert found.plan.cycles == 30
    assert sorted(leaf.rpartition("/")[2] for leaf in found.plan.tree.leaves) == ["a", "b", "c"]
    assert found.plan.tree.parents == ("", "c1", "c2")
    assert found.plan.tree.rating_kw("") == 300.0
    assert found.profile.mpp_kw.shape == (30, 3)
    assert set(found.profile.commitment_kw.tolist()) == {100.0}
    assert found.local_start() == "2024-05-12 13:00:00 CEST"
    assert found.plan.lockstep
    assert not found.hindsight


def test_the_command_line_may_change_time_and_pace(folder: Folder) -> None:
    found = folder.prepare(start="07:30", duration="1m", pace=2.0)
    assert found.local_start() == "2024-05-12 07:30:00 CEST"
    assert found.plan.cycles == 60
    assert found.plan.cycle_wall_ns == 500_000_000


def test_deadlines_are_as_the_scenario_says(folder: Folder) -> None:
    assert folder.prepare(pace=1.0).plan.tier_deadlines_ns == ()
    said = "[[2, 1]]\ndeadlines_ms = [20, 30.5, 40]"
    folder.write("scenario.toml", SCENARIO.replace("[[2, 1]]", said))
    found = folder.prepare(pace=1.0).plan
    assert found.tier_deadlines_ns == (20_000_000, 30_500_000, 40_000_000)


def test_the_meter_corrects_with_the_scheme_that_looks_ahead_unless_the_scenario_says(
    folder: Folder,
) -> None:
    assert folder.prepare(scheme="predictive").plan.correction
    assert not folder.prepare(scheme="paper").plan.correction
    folder.change("[[2, 1]]", "[[2, 1]]\ncorrection = true")
    assert folder.prepare(scheme="paper").plan.correction
    folder.change("correction = true", "correction = false")
    assert not folder.prepare(scheme="predictive").plan.correction


def test_inverters_state_their_available_power_if_the_scenario_says(folder: Folder) -> None:
    assert folder.prepare().plan.available_bias is None
    folder.change("[plant]", "[plant]\navailable_bias = 0.02")
    assert folder.prepare().plan.available_bias == 0.02


def test_a_cycle_too_short_for_any_clock_is_refused(folder: Folder) -> None:
    with pytest.raises(InputError, match="beyond the clock's resolution"):
        folder.prepare(pace=1e6)


def test_a_moment_with_an_offset_is_that_moment(folder: Folder) -> None:
    assert folder.prepare(start="2024-05-12T10:00:00Z").local_start() == "2024-05-12 12:00:00 CEST"


def test_tiers_above_tiers_are_named_by_their_letters(folder: Folder) -> None:
    folder.change("[[2, 1]]", "[[2, 1], [2]]")
    folder.change("cluster_sizes", 'clusters = "listed"\ncluster_sizes')
    assert folder.prepare().plan.tree.leaves == ("z1/c1/a", "z1/c1/b", "z1/c2/c")


@pytest.mark.parametrize(
    ("counts", "leaves"),
    [
        ("[1]", "c1/a c1/b c1/c"),
        ("[2]", "c1/a c1/b c2/c"),
        ("[3, 2]", "z1/c1/a z1/c2/b z2/c3/c"),
    ],
)
def test_clusters_may_be_counted_and_are_then_as_equal_as_can_be(
    folder: Folder, counts: str, leaves: str
) -> None:
    folder.change("cluster_sizes = [[2, 1]]", f'clusters = "listed"\ncluster_count = {counts}')
    assert folder.prepare().plan.tree.leaves == tuple(leaves.split())


@pytest.mark.parametrize(
    ("new", "complaint"),
    [
        (
            "cluster_count = [4]",
            "control.cluster_count[0] is 4, accepted are 1 to 3 clusters",
        ),
        (
            "cluster_count = [2, 3]",
            "control.cluster_count[1] is 3, accepted are 1 to 2 clusters",
        ),
        ("cluster_count = [0]", "control.cluster_count[0]: Expected `int` >= 1"),
        (
            "",
            "control.cluster_sizes and cluster_count: neither given, accepted is one of the two",
        ),
        (
            "cluster_sizes = [[2, 1]]\ncluster_count = [2]",
            "control.cluster_sizes and cluster_count: both given, accepted is one of the two",
        ),
    ],
)
def test_clusters_that_cannot_be_are_refused(folder: Folder, new: str, complaint: str) -> None:
    folder.change("cluster_sizes = [[2, 1]]", new)
    assert folder.complaint() == f"{folder.scenario}: {complaint}"


def test_measured_irradiance_brings_its_own_inverters(measured: Folder) -> None:
    found = measured.prepare()
    assert set(found.plan.tree.leaves) == {"c1/inv16", "c1/inv40"}
    assert found.plan.tree.rating_kw("c1/inv16") == 100.0
    assert found.profile.mpp_kw.shape == (4, 2)
    assert found.hindsight


def test_data_may_lie_in_a_folder_of_its_own(measured: Folder, tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    for name in ("ghi.csv", "positions.csv"):
        (measured.path / name).rename(data / name)
    assert measured.complaint() == (
        f"{measured.path / 'ghi.csv'}: no such file, accepted is --data with the folder that "
        "holds it"
    )
    scenario = load_scenario(str(measured.scenario), data)
    assert prepare(scenario, RunOptions(), "by-hand").plan.cycles == 4


@pytest.mark.parametrize("name", shipped_scenarios())
def test_every_shipped_scenario_loads(name: str) -> None:
    scenario = load_scenario(name).scenario
    assert scenario.name == name
    assert scenario.title


@pytest.mark.parametrize(
    ("name", "inverters", "clusters"), [("oahu", 17, 3), ("valley", 60, 12 + 3)]
)
def test_shipped_scenarios_under_clouds_need_no_data(
    name: str, inverters: int, clusters: int
) -> None:
    found = prepare(load_scenario(name), RunOptions(duration="20s"), "by-hand")
    assert found.profile.mpp_kw.shape == (20, inverters)
    assert len(found.plan.tree.parents) == 1 + clusters
    assert found.profile.mpp_kw.min() >= 0.0
    ratings_kw = [rating_kw for _, rating_kw in found.plan.inverters]
    assert (found.profile.mpp_kw <= ratings_kw).all()


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("90", 90), ("90s", 90), ("15m", 900), ("1h30m", 5400), ("0.5h", 1800), ("1h1m1s", 3661)],
)
def test_durations(text: str, seconds: float) -> None:
    assert parse_duration_s(text, "--duration") == seconds


# Bad scenario files -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        (
            "rating_kw",
            "rating_mw",
            "plant: Object contains unknown field `rating_mw`, accepted: inverters, rating_kw, "
            "altitude_m, actuator, meter_noise, available_bias, meter_seed, "
            "ramp_limit_percent_per_min",
        ),
        (
            'title = "',
            'motto = "',
            "Object contains unknown field `motto`, accepted: name, title, time, plant, "
            "irradiance, control, neighbours, commitment, regulation, pv, pace, faults, "
            "faults_seed, machine, timing",
        ),
        (
            "seed = 7",
            "seeds = 7",
            "irradiance: Object contains unknown field `seeds`, accepted: kind, seed, clouds",
        ),
        (
            "[control]",
            "[machine]\nnice = 3\n[control]",
            "machine: Object contains unknown field `nice`, accepted: cpus, priority, lock_memory",
        ),
        (
            "[control]",
            "[timing.budget]\nloop_p99_ms = 3\n[control]",
            "timing: Object contains unknown field `budget`, accepted: budgets",
        ),
        (
            "[control]",
            '[[faults]]\ndelay = "5ms"\n[control]',
            "faults[0]: Object contains unknown field `delay`, accepted: source, listener, signal, "
            "delay_ms, jitter_ms, distribution, loss, duplicate, reorder, reorder_ms, silent",
        ),
        ("rating_kw = 300", "rating_kw = -300", "plant.rating_kw: Expected `float` > 0.0"),
        (
            "rating_kw = 300",
            'rating_kw = "8 MW"',
            "plant.rating_kw: Expected `float | null`, got `str`",
        ),
        (
            'history = "earlier-day"',
            'history = "later"',
            "neighbours.history: Invalid enum value 'later', accepted: earlier-day, hindsight",
        ),
        (
            'kind = "clouds"',
            'kind = "moon"',
            "irradiance.kind: Invalid value 'moon', accepted: clouds, measured, oahu-grid, "
            "dc-current",
        ),
        ("[[2, 1]]", "[[3, 0]]", "control.cluster_sizes[0][1]: Expected `int` >= 1"),
        (
            "2024-05-12T13:00:00",
            '"13:00"',
            "time.start: Expected `datetime`, got `str`",
        ),
        (
            "Europe/Madrid",
            "Europe/Madird",
            "time.timezone is 'Europe/Madird', accepted is an IANA name such as Pacific/Honolulu",
        ),
        (
            "[time]",
            "[time",
            "not TOML: Expected ']' at the end of a table declaration (at line 4, column 6)",
        ),
        (
            "[[2, 1]]",
            "[[2, 2]]",
            "control.cluster_sizes[0] adds up to 4, accepted are sizes that add up to 3",
        ),
        (
            "[[2, 1]]",
            "[[2, 1], [2, 1]]",
            "control.cluster_sizes[1] adds up to 3, accepted are sizes that add up to 2",
        ),
        (
            "[[2, 1]]",
            "[[2, 1]]\nperiod_cycles = [10, 5, 1]",
            "control.period_cycles has 3 entries, accepted is one for each of the 2 tiers that "
            "have children",
        ),
        (
            "[[2, 1]]",
            "[[2, 1]]\ndeadlines_ms = [0, 20, 30]",
            "control.deadlines_ms[0] is 0 ms, accepted is a number from 0.1 to 3,600,000,000",
        ),
        (
            "[[2, 1]]",
            '[[2, 1]]\nscheme = "hold"',
            "control.scheme: Invalid enum value 'hold', accepted: paper, predictive",
        ),
        (
            'inverters = "plant.csv"\n',
            "",
            "plant.inverters is missing, accepted is a CSV with the columns inverter, lat, lon",
        ),
        ("seed = 7", "seed = -7", "irradiance.seed: Expected `int` >= 0"),
        ("duration_s = 30", "duration_s = inf", "time.duration_s: Expected `float` <= 2678400.0"),
        ("duration_s = 30", "duration_s = nan", "time.duration_s: Expected `float` > 0.0"),
        (
            "duration_s = 30",
            "duration_s = 1e-9\ncycle_s = 1e-10",
            "time.cycle_s: Expected `float` >= 0.001",
        ),
        ("rating_kw = 300", "rating_kw = inf", "plant.rating_kw: Expected `float` <= 10000000.0"),
        ("rating_kw = 300", "rating_kw = 1e308", "plant.rating_kw: Expected `float` <= 10000000.0"),
        (
            "rating_kw = 300",
            "rating_kw = 300\naltitude_m = nan",
            "plant.altitude_m: Expected `float` >= -500.0",
        ),
        (
            "power_kw = 100",
            "power_kw = inf",
            "commitment.power_kw: Expected `float` <= 100000000.0",
        ),
        ("power_kw = 100", "power_kw = nan", "commitment.power_kw: Expected `float` >= 0.0"),
        ('title = "', 'pace = 1e-320\ntitle = "', "pace: Expected `float` >= 0.001"),
        ('title = "', 'pace = 1e7\ntitle = "', "pace: Expected `float` <= 1000000.0"),
    ],
)
def test_a_bad_scenario_is_told_with_file_and_field(
    folder: Folder, old: str, new: str, complaint: str
) -> None:
    folder.change(old, new)
    assert folder.complaint() == f"{folder.scenario}: {complaint}"


@pytest.mark.parametrize("name", ["../x", "a/b", "a b", "*", ""])
def test_a_name_that_cannot_stand_in_a_key_is_refused(folder: Folder, name: str) -> None:
    folder.change('"small"', f'"{name}"')
    assert folder.complaint() == (
        f"{folder.scenario}: name '{name}', accepted are letters, digits, '_' and '-'"
    )


def test_a_scenario_that_is_not_utf8_is_told_with_the_byte(folder: Folder) -> None:
    content = folder.scenario.read_bytes().replace(b"Three", b"Thr\xe9")
    folder.scenario.write_bytes(content)
    place = content.index(b"\xe9")
    assert folder.complaint() == f"{folder.scenario}: not UTF-8 at byte {place}, accepted is TOML"


def test_a_table_that_is_missing_is_named(folder: Folder) -> None:
    folder.change('[neighbours]\nhistory = "earlier-day"\n', "")
    assert folder.complaint() == (f"{folder.scenario}: Object missing required field `neighbours`")


def test_a_scenario_that_is_not_there_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scenario.toml"
    with pytest.raises(InputError) as caught:
        load_scenario(str(path))
    assert str(caught.value) == f"{path}: no such scenario file"


def test_an_unknown_name_is_told_with_the_known_ones() -> None:
    with pytest.raises(InputError) as caught:
        load_scenario("ohau")
    assert str(caught.value) == (
        f"scenario 'ohau' is not known, accepted: {', '.join(shipped_scenarios())} "
        "or the path of a .toml file"
    )


def test_a_duration_that_is_no_multiple_of_the_cycle_is_refused(folder: Folder) -> None:
    folder.change("duration_s = 30", "duration_s = 30\ncycle_s = 4")
    assert folder.complaint() == (
        f"{folder.scenario}: time.duration_s: 30 s, accepted are multiples of the cycle, 4 s"
    )


# Bad inverters ------------------------------------------------------------------------------------


def test_a_missing_file_is_refused(folder: Folder) -> None:
    folder.change("plant.csv", "plants.csv")
    path = folder.path / "plants.csv"
    assert folder.complaint() == f"{path}: no such file, accepted is a CSV of inverters"


def test_an_empty_name_of_the_inverters_file_is_refused(folder: Folder) -> None:
    folder.change('"plant.csv"', '""')
    assert folder.complaint() == f"{folder.path}: Is a directory, accepted is a CSV of inverters"


def test_two_inverters_of_one_name_are_refused(folder: Folder) -> None:
    folder.change("c,", "a,", "plant.csv")
    assert folder.complaint() == (
        f"{folder.path / 'plant.csv'}, line 4: inverter a is in line 2 already, names must differ"
    )


def test_a_negative_rating_of_an_inverter_is_refused(folder: Folder) -> None:
    folder.write("plant.csv", "inverter,lat,lon,rating_kw\na,37.1,-4.2,100\nb,37.1,-4.2,-5\n")
    assert folder.complaint() == (
        f"{folder.path / 'plant.csv'}, line 3: rating_kw is '-5', "
        "accepted is a number above 0 to 1e+07"
    )


def test_inverters_without_any_rating_are_refused(folder: Folder) -> None:
    folder.change("rating_kw = 300\n", "")
    assert folder.complaint() == (
        f"{folder.path / 'plant.csv'}: no ratings, accepted is plant.rating_kw or a column "
        "rating_kw"
    )


# Bad measurements ---------------------------------------------------------------------------------


def test_a_measurement_that_is_no_number_is_refused(measured: Folder) -> None:
    measured.change("300", "NaN", "ghi.csv")
    assert measured.complaint() == (
        "ghi.csv: line 3, column '40': found 'NaN'; accepted: a number in W/m2"
    )


def test_a_position_without_its_column_is_refused(measured: Folder) -> None:
    measured.change("lon", "longitude", "positions.csv")
    assert measured.complaint() == (
        "positions.csv: line 1: no column 'lon'; "
        "accepted: the columns station, lat, lon; found station, lat, longitude"
    )


def test_a_station_without_a_position_is_refused(measured: Folder) -> None:
    measured.change("40,", "41,", "positions.csv")
    assert measured.complaint() == (
        "positions.csv: no position for station '40'; accepted: a line for each station"
    )


def test_a_station_without_measurements_is_refused(measured: Folder) -> None:
    measured.change('positions = "positions.csv"', 'positions = "positions.csv"\nstations = ["7"]')
    assert measured.complaint() == (
        "ghi.csv: line 1: no column for station '7'; its stations are 16, 40"
    )


@pytest.mark.parametrize(("cycle_s", "cycles"), [("0.5", 8), ("2", 2)])
def test_a_cycle_may_be_shorter_or_longer_than_the_step_of_the_measurements(
    measured: Folder, cycle_s: str, cycles: int
) -> None:
    measured.change("duration_s = 4", f"duration_s = 4\ncycle_s = {cycle_s}")
    found = measured.prepare()
    assert found.profile.mpp_kw.shape == (cycles, 2)
    assert len(found.remarks) == 1


def test_a_cycle_that_is_no_multiple_of_the_step_is_refused(measured: Folder) -> None:
    measured.change("duration_s = 4", "duration_s = 3\ncycle_s = 1.5")
    assert measured.complaint() == (
        f"{measured.path / 'ghi.csv'}: a value every 1 s; accepted is a time.cycle_s that is a "
        "multiple of it, or shorter, found 1.5 s"
    )


def test_history_is_hindsight_under_a_measured_sky(measured: Folder) -> None:
    measured.change("hindsight", "earlier-day")
    assert measured.complaint() == (
        f"{measured.scenario}: neighbours.history is 'earlier-day', accepted with measurements "
        "of one day is 'hindsight'"
    )


# Bad options --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", ["0", "-5", "soon", "5 s", "5d", "1e3", ".", "s", "1.2.3", "1..5", "1.", ".5"]
)
def test_a_duration_that_is_none_is_refused(folder: Folder, text: str) -> None:
    assert folder.complaint(duration=text) == f"--duration {text}: {DURATIONS}"


@pytest.mark.parametrize("text", ["2678401", "745h", "10000000000"])
def test_a_duration_of_more_than_31_days_is_refused(folder: Folder, text: str) -> None:
    assert folder.complaint(duration=text) == f"--duration {text}: {DURATIONS}"


def test_a_duration_of_31_days_is_accepted() -> None:
    assert parse_duration_s("744h", "--duration") == 31 * 86400.0


def test_a_duration_of_hundreds_of_digits_is_refused_in_a_short_line(folder: Folder) -> None:
    complaint = folder.complaint(duration="9" * 400)
    assert complaint.startswith("--duration ")
    assert complaint.endswith(f": {DURATIONS}")
    assert len(complaint) < 140


@pytest.mark.parametrize("text", ["0.5", "1.25s"])
def test_a_duration_of_half_a_cycle_is_refused(folder: Folder, text: str) -> None:
    assert folder.complaint(duration=text) == (
        f"--duration {text}: accepted are multiples of the cycle, 1 s"
    )


@pytest.mark.parametrize("text", ["noon", "25:00", "12:60", "2024-13-01T12:00", ""])
def test_a_start_that_is_none_is_refused(folder: Folder, text: str) -> None:
    assert folder.complaint(start=text) == f"--start {text}: {STARTS}"


@pytest.mark.parametrize("text", ["9:05", "2024-05-12T9:05", "2024-05-12 9:05:00"])
def test_an_hour_may_have_one_digit(folder: Folder, text: str) -> None:
    assert folder.prepare(start=text).local_start().startswith("2024-05-12 09:05:00 ")


@pytest.mark.parametrize("text", ["12:30+05:00", "12:30Z"])
def test_a_time_of_day_with_an_offset_is_refused(folder: Folder, text: str) -> None:
    assert folder.complaint(start=text) == f"--start {text}: {STARTS}"


@pytest.mark.parametrize(
    "text", ["0001-01-01", "1899-12-31", "2201-01-01", "2300-01-01T00:00", "9999-01-01"]
)
def test_a_start_in_a_year_far_away_is_refused(folder: Folder, text: str) -> None:
    assert folder.complaint(start=text) == f"--start {text}: {STARTS}"


@pytest.mark.parametrize("day", ["1900-01-01", "2200-12-31"])
def test_the_first_and_the_last_day_that_a_run_can_start_on(folder: Folder, day: str) -> None:
    assert folder.prepare(start=f"{day}T12:00").local_start().startswith(f"{day} 12:00:00 ")


def test_a_seed_below_0_is_refused(folder: Folder) -> None:
    assert folder.complaint(seed=-1) == "--seed -1: accepted is 0 to 4294967296"


def test_a_start_before_the_measurements_is_refused(measured: Folder) -> None:
    assert measured.complaint(start="09:14") == (
        f"{measured.path / 'ghi.csv'}: does not cover 2013-09-08T09:14:00Z to "
        "2013-09-08T09:14:04Z; it covers 2013-09-08T09:15:00Z to 2013-09-08T09:15:04Z"
    )


def test_a_duration_beyond_the_measurements_is_refused(measured: Folder) -> None:
    assert measured.complaint(duration="5s") == (
        f"{measured.path / 'ghi.csv'}: does not cover 2013-09-08T09:15:00Z to "
        "2013-09-08T09:15:05Z; it covers 2013-09-08T09:15:00Z to 2013-09-08T09:15:04Z"
    )


def test_measurements_have_no_seed(measured: Folder) -> None:
    assert measured.complaint(seed=3) == (
        "--seed: the scenario's irradiance is measured, it has no seed"
    )


# On the command line ------------------------------------------------------------------------------

Complain = Callable[..., str]


@pytest.fixture
def complain(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> Complain:
    """Run a command that must fail in an empty folder, and return its one line."""
    empty = folder.path / "empty"
    empty.mkdir()
    monkeypatch.chdir(empty)

    def run(*words: str) -> str:
        result = CliRunner().invoke(app, list(words))
        assert (result.exit_code, result.stdout) == (2, "")
        assert list(empty.iterdir()) == []
        (line,) = result.stderr.splitlines()
        return str(line)

    return run


@pytest.mark.parametrize("command", ["launch", "simulate"])
def test_bad_input_is_one_line_exit_status_2_and_no_folder(
    folder: Folder, complain: Complain, command: str
) -> None:
    folder.change("rating_kw = 300", "rating_kw = -300")
    assert complain(command, str(folder.scenario)) == (
        f"heliarch: {folder.scenario}: plant.rating_kw: Expected `float` > 0.0"
    )


def test_an_unknown_scenario_leaves_nothing_behind(complain: Complain) -> None:
    assert complain("simulate", "ohau") == (
        f"heliarch: scenario 'ohau' is not known, accepted: {', '.join(shipped_scenarios())} "
        "or the path of a .toml file"
    )


@pytest.mark.parametrize("pace", ["0", "-1", "0.0009", "1e-320", "1e7", "nan", "inf", "fast", ""])
def test_a_pace_that_is_none_is_refused(folder: Folder, complain: Complain, pace: str) -> None:
    assert complain("simulate", str(folder.scenario), "--pace", pace) == (
        f"heliarch: --pace {pace}: accepted is a number from 0.001 to 1e+06, or max"
    )


@pytest.mark.parametrize(
    ("option", "text", "complaint"),
    [
        ("--start", "noon", STARTS),
        ("--duration", "soon", DURATIONS),
    ],
)
def test_a_bad_time_is_refused(
    folder: Folder, complain: Complain, option: str, text: str, complaint: str
) -> None:
    assert complain("simulate", str(folder.scenario), option, text) == (
        f"heliarch: {option} {text}: {complaint}"
    )


def test_a_seed_for_measurements_is_refused(measured: Folder, complain: Complain) -> None:
    assert complain("simulate", str(measured.scenario), "--seed", "3") == (
        "heliarch: --seed: the scenario's irradiance is measured, it has no seed"
    )


def test_a_folder_that_holds_something_is_left_alone(folder: Folder, complain: Complain) -> None:
    taken = folder.path / "taken"
    taken.mkdir()
    (taken / "thesis.tex").write_text("years of work", encoding="utf-8")
    assert complain("simulate", str(folder.scenario), "--out", str(taken)) == (
        f"heliarch: --out {taken}: it exists already, accepted is a new or empty folder"
    )
    assert [path.name for path in taken.iterdir()] == ["thesis.tex"]


def test_bad_input_to_the_program_itself(tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "launch_scripts", "simulate", "ohau", "--out", "run"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith("heliarch: scenario 'ohau' is not known, accepted: ")
    assert len(result.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
