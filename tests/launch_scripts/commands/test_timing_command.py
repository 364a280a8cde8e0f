"""`heliarch timing` refuses in one line what it cannot do, and loses nothing that it measured."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest
from msgspec.structs import replace
from reports_by_hand import missed, reported, summary_of
from timed_recordings import PLAN, cycle, recorded
from typer.testing import CliRunner, Result

from bus_schemas.errors import InputError
from launch_scripts.cli import app
from launch_scripts.commands import timing as timing_command
from launch_scripts.launcher.interruption import interruptible
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from studies.timing.measured_run import whole_cycles
from studies.timing.report import Reported
from studies.timing.table import print_report

FULL: Final = Path("/dev/full")


def timed(*words: str | Path) -> Result:
    return CliRunner().invoke(app, ["timing", *map(str, words)])


def refused(*words: str | Path) -> str:
    """The one line with which it refuses."""
    result = timed(*words)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("heliarch: ")
    return line


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--rate", "0"), "--rate 0"),
        (("--rate", "5000"), "--rate 5000"),
        (("--rate", "10", "--duration", "0.05"), "--duration 0.05"),
        (("--rate", "0.1..5", "--duration", "5s"), "--duration 5s"),
        (("--duration", "soon"), "--duration: expected"),
        (("--external", "c9"), "--external: expected"),
        (("--study", "--rate", "20"), "--rate"),
        (("--study", "--fault", "loss=1%"), "--fault"),
        (("--set", "commitment.share=0.5"), "--set"),
        (("--workers", "3"), "--workers"),
        (("--study", "--workers", "0"), "--workers 0"),
        (("--study", "--rate", ""), "--rate"),
        (("--rate", ""), "--rate"),
        (("--duration", "1", "--out", "/dev/null/run"), "--out: expected"),
        (("--rate", "5,10", "--out", "/dev/null/run"), "--out: expected"),
        (("--json", "/absent/x.json"), "/absent/x.json"),
        (("absent.mcap",), "absent.mcap"),
        (("absent.mcap", "--rate", "20"), "--rate"),
        (("absent.mcap", "--priority", "20"), "--priority"),
    ],
)
def test_what_makes_no_sense_is_refused(
    words: tuple[str, ...], named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert named in refused(*words)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_holds_something_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").touch()
    assert "exists already" in refused("--out", tmp_path)
    assert "exists already" in refused("--rate", "5,10", "--out", tmp_path)


def test_a_budget_that_there_is_none_of_is_refused_with_the_scenario_named(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(load_scenario("oahu").text + "\n[timing.budgets]\nlop_p99_ms = 3\n")
    line = refused(path)
    assert f"{path}: timing.budgets: expected the fields loop_p99_ms" in line
    assert "loop_p99_ms" in line


def with_deadlines(tmp_path: Path) -> Path:
    """A scenario whose deadlines fit into cycles of 61 ms or more."""
    path = tmp_path / "stated.toml"
    text = load_scenario("oahu").text
    assert "\n[control]\n" in text
    stated = "\n[control]\ndeadlines_ms = [20, 40, 60]\n"
    path.write_text(text.replace("\n[control]\n", stated))
    return path


def test_a_listed_rate_that_cannot_be_is_refused_before_any_has_run(tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    line = refused(with_deadlines(tmp_path), "--rate", "5,10,20", "--duration", "1", "--out", out)
    assert "control.deadlines_ms[2]" in line
    assert not out.exists()


@pytest.mark.parametrize(
    ("rate_hz", "duration", "cycles"),
    [(10.0, "4s", 40), (3.0, "1m", 180), (7.0, "0.5", 4), (0.5, "2s", 1), (30.0, "10m", 18_000)],
)
def test_a_duration_is_a_whole_number_of_cycles(rate_hz: float, duration: str, cycles: int) -> None:
    assert whole_cycles(rate_hz, duration) == cycles


def test_of_less_than_a_cycle_there_is_nothing_to_measure() -> None:
    with pytest.raises(InputError, match="--duration 1s"):
        whole_cycles(0.5, "1s")


def test_the_rate_changes_neither_clusters_nor_neighbours() -> None:
    scenario = load_scenario("oahu")
    slow = prepare(scenario, RunOptions("12:30", "2s"), "slow").plan
    fast = prepare(scenario, RunOptions("12:30", "2s", pace=1.0, cycle_s=0.05), "fast").plan
    assert (slow.cycles, fast.cycles) == (2, 40)
    assert (fast.cycle_ns, fast.cycle_wall_ns) == (50_000_000, 50_000_000)
    assert fast.inverters == slow.inverters
    assert fast.neighbourhoods == slow.neighbourhoods


@pytest.mark.parametrize("of_a_folder", [True, False])
def test_a_run_that_was_recorded_earlier_is_timed_without_running_anything(
    of_a_folder: bool, tmp_path: Path
) -> None:
    folder = recorded(tmp_path, cycle(0), missed(1))
    (folder / "summary.json").write_bytes(summary_of(folder).as_json())
    document = tmp_path / "x.json"
    run = folder if of_a_folder else folder / "run.mcap"
    result = timed(run, "--json", document, "--report", "--processes")
    assert result.exit_code == 1, result.output
    assert "not kept: missed deadlines 1 (at most 0)" in result.stdout
    found = json.loads(document.read_bytes())
    assert (found["cycles"], found["lost_messages"]) == (2, 0)
    assert found["processes"][0]["times"]
    assert "FAIL: " in (folder / "timing.html").read_text(encoding="utf-8")


def test_a_recording_of_a_run_in_lockstep_is_refused(tmp_path: Path) -> None:
    recorded(tmp_path, cycle(0), plan=replace(PLAN, cycle_wall_ns=0))
    assert "real time" in refused(tmp_path)


@pytest.mark.parametrize(
    ("lost", "interrupted", "status"), [(0, False, 0), (1, False, 1), (0, True, 130)]
)
def test_the_exit_status_tells_kept_not_kept_and_interrupted(
    lost: int, interrupted: bool, status: int, tmp_path: Path
) -> None:
    folder = recorded(tmp_path, cycle(0), cycle(1))
    summary = replace(summary_of(folder, lost=lost), interrupted=interrupted)
    (folder / "summary.json").write_bytes(summary.as_json())
    assert timed(folder).exit_code == status


@pytest.fixture
def over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run that ends at once, in the folder `run` of this one."""

    def ended(_: Preparation, folder: object, *__: object, **___: object) -> Reported:
        return reported(tmp_path / "run")

    monkeypatch.setattr(timing_command, "measured_run", ended)
    return tmp_path


@pytest.mark.skipif(not FULL.exists(), reason="this system has no device that is full")
def test_a_file_that_cannot_be_written_costs_neither_the_verdict_nor_another_file(
    over: Path,
) -> None:
    result = timed("--json", FULL, "--report", "--duration", "1", "--out", over / "run")
    assert "PASS: all " in result.stdout
    (line,) = result.stderr.splitlines()
    assert str(FULL) in line
    assert result.exit_code == 1
    assert "PASS: all " in (over / "run" / "timing.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("signum", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)]
)
def test_what_was_measured_before_a_signal_is_printed_and_written(
    signum: signal.Signals, status: int, over: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ended(*_: object, **__: object) -> Reported:
        with interruptible() as interruption:
            signal.raise_signal(signum)
        assert interruption.count == 1
        found = reported(over / "run")
        return replace(found, report=replace(found.report, interrupted=True))

    monkeypatch.setattr(timing_command, "measured_run", ended)
    document = over / "x.json"
    result = timed("--json", document, "--duration", "1", "--out", over / "run")
    assert "PASS: all " in result.stdout
    assert json.loads(document.read_bytes())["interrupted"]
    assert result.exit_code == status


@pytest.mark.parametrize(("signum", "status"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_while_the_tables_are_printed_cuts_nothing(
    signum: signal.Signals, status: int, over: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def signalled(*words: object, **named: object) -> None:
        signal.raise_signal(signum)
        print_report(*words, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(timing_command, "print_report", signalled)
    result = timed("--duration", "1", "--out", over / "run")
    assert "PASS: all " in result.stdout
    assert result.exit_code == status


def test_a_run_that_is_ended_by_force_is_told_in_one_line(
    over: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(timing_command, "measured_run", interrupted)
    result = timed("--duration", "1", "--out", over / "run")
    assert len(result.stderr.splitlines()) == 1
    assert result.exit_code == 130


def test_a_signal_during_a_sweep_keeps_the_rates_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ended(preparation: Preparation, *_: object, **__: object) -> Reported:
        if preparation.plan.cycle_wall_ns < 200_000_000:
            signal.raise_signal(signal.SIGTERM)  # Before there is a cycle to be ended.
        found = reported(tmp_path / "run")
        return replace(found, report=replace(found.report, rate_hz=5.0))

    monkeypatch.setattr(timing_command, "measured_run", ended)
    document = tmp_path / "x.json"
    words = ("--rate", "5,10,20", "--duration", "1", "--out", tmp_path / "rates")
    result = timed(*words, "--json", document)
    assert "highest clean rate: at least 5 cycles/s" in result.stdout
    rows = json.loads(document.read_bytes())["rows"]
    assert [(row["rate_hz"], row["interrupted"]) for row in rows] == [(5.0, False), (10.0, True)]
    assert result.exit_code == 143


def test_a_disk_that_is_full_before_the_run_is_named(
    over: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> Iterator[None]:
        raise OSError(28, "No space left on device", "run/plan.json")

    monkeypatch.setattr(timing_command, "measured_run", full)
    result = timed("--duration", "1", "--out", over / "run")
    (line,) = result.stderr.splitlines()
    assert "run/plan.json" in line
    assert result.exit_code == 1
