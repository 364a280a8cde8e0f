"""`heliarch timing` refuses in one line what it cannot do, and loses nothing that it measured."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Final, NamedTuple

import pytest
from msgspec.structs import replace
from timings_by_hand import REAL_TIME, report
from typer.testing import CliRunner, Result

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from launch_scripts.cli import app
from launch_scripts.interruption import interruptible
from launch_scripts.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenario import load_scenario
from launch_scripts.timing import timing_command, trials
from launch_scripts.timing.measured_run import whole_cycles
from launch_scripts.timing.timing_command import exit_status
from launch_scripts.timing.timing_report import TimingReport

FULL: Final = Path("/dev/full")


def refused(*words: str | Path) -> str:
    """The one line with which it refuses."""
    result = CliRunner().invoke(app, ["timing", *map(str, words)])
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("heliarch: ")
    return line


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--rate", "0"), "--rate 0: accepted is a number above 0"),
        (("--rate", "5000"), "accepted is at most 1000 cycles/s"),
        (("--rate", "10", "--duration", "0.05"), "shorter than one cycle, accepted is 0.1 s"),
        (("--rate", "0.1..5", "--duration", "5s"), "shorter than one cycle, accepted is 10 s"),
        (("--duration", "soon"), "--duration soon: accepted are seconds above 0"),
        (("--external", "c9"), "--external c9: this run has no such agent"),
        (("--study", "--rate", "20"), "--rate: a study runs in memory"),
        (("--study", "--fault", "loss=1%"), "--fault: a study runs in memory"),
        (("--set", "commitment.share=0.5"), "--set: it is for a study"),
        (("--workers", "3"), "--workers: it is for a study"),
        (("--study", "--workers", "0"), "--workers 0: accepted are 1 to 256"),
        (("--study", "--rate", ""), "--rate: a study runs in memory"),
        (("--rate", ""), "--rate : '' is no number"),
        (("--duration", "1", "--out", "/dev/null/run"), "--out /dev/null/run: no folder can be"),
        (("--rate", "5,10", "--out", "/dev/null/run"), "--out /dev/null/run: no folder can be"),
        (("--json", "/absent/x.json"), "accepted is a file in an existing folder, or -"),
    ],
)
def test_what_makes_no_sense_is_refused(
    words: tuple[str, ...], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert told in refused(*words)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_holds_something_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").touch()
    assert "it exists already" in refused("--out", tmp_path)
    assert "it exists already" in refused("--rate", "5,10", "--out", tmp_path)


def test_a_budget_that_there_is_none_of_is_refused_with_the_scenario_named(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(load_scenario("oahu").text + "\n[timing.budgets]\nlop_p99_ms = 3\n")
    line = refused(path)
    assert f"{path}: timing: budgets.lop_p99_ms: no such budget, accepted are age_p99_ms" in line
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
    assert "control.deadlines_ms[2] is 60 ms, accepted is less than the cycle" in line
    assert not out.exists()


@pytest.mark.parametrize(
    ("rate_hz", "duration", "cycles"),
    [(10.0, "4s", 40), (3.0, "1m", 180), (7.0, "0.5", 4), (0.5, "2s", 1), (30.0, "10m", 18_000)],
)
def test_a_duration_is_a_whole_number_of_cycles(rate_hz: float, duration: str, cycles: int) -> None:
    assert whole_cycles(rate_hz, duration) == cycles


def test_of_less_than_a_cycle_there_is_nothing_to_measure() -> None:
    with pytest.raises(InputError, match=r"accepted is 2 s or more at 0\.5 cycles/s"):
        whole_cycles(0.5, "1s")


def test_the_rate_changes_neither_clusters_nor_neighbours() -> None:
    scenario = load_scenario("oahu")
    slow = prepare(scenario, RunOptions("12:30", "2s"), "slow").plan
    fast = prepare(scenario, RunOptions("12:30", "2s", pace=1.0, cycle_s=0.05), "fast").plan
    assert (slow.cycles, fast.cycles) == (2, 40)
    assert (fast.cycle_ns, fast.cycle_wall_ns) == (50_000_000, 50_000_000)
    assert fast.inverters == slow.inverters
    assert fast.neighbourhoods == slow.neighbourhoods


def test_the_exit_status_tells_kept_not_kept_and_interrupted() -> None:
    kept, broken = report(), report(lost=1)
    assert exit_status(kept) == 0
    assert exit_status(broken) == 1
    assert exit_status(replace(kept, interrupted=True)) == 130


class Ran(NamedTuple):
    """Stands in for a run that is over."""

    recording: Path
    unwritten: str = ""
    plan: RunPlan = REAL_TIME


@pytest.fixture
def over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run that ends at once, in this folder, with a report made by hand."""
    ran = Ran(tmp_path / "run.mcap")
    monkeypatch.setattr(timing_command, "measured_run", lambda *_: ran)
    monkeypatch.setattr(timing_command, "report_on", lambda _: (report(), ()))
    return tmp_path


def timed(*words: str | Path) -> Result:
    return CliRunner().invoke(app, ["timing", *map(str, words)])


@pytest.mark.skipif(not FULL.exists(), reason="this system has no device that is full")
def test_a_file_that_cannot_be_written_costs_neither_the_verdict_nor_another_file(
    over: Path,
) -> None:
    result = timed("--json", FULL, "--report", "--duration", "1", "--out", over / "run")
    assert "PASS: all " in result.stdout
    assert result.stderr == f"heliarch: not written: {FULL}: No space left on device\n"
    assert result.exit_code == 1
    assert "PASS: all " in (over / "timing.html").read_text(encoding="utf-8")


def test_a_summary_and_a_page_that_cannot_be_written_are_told(
    over: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = Ran(over / "absent" / "run.mcap", unwritten="summary.json: No space left on device")
    monkeypatch.setattr(timing_command, "measured_run", lambda *_: ran)
    document = over / "x.json"
    result = timed("--json", document, "--report", "--duration", "1", "--out", over / "run")
    told = result.stderr.splitlines()
    assert told[0] == "heliarch: not written: summary.json: No space left on device"
    assert told[1].startswith(f"heliarch: not written: report {over / 'absent' / 'timing.html'}: ")
    assert (len(told), result.exit_code) == (2, 1)
    assert "PASS: all " in result.stdout
    assert json.loads(document.read_bytes())["passed"]


@pytest.mark.parametrize(
    ("signum", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)]
)
def test_what_was_measured_before_a_signal_is_printed_and_written(
    signum: signal.Signals, status: int, over: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts: list[int] = []

    def ended(*_: object) -> Ran:
        with interruptible() as interruption:
            signal.raise_signal(signum)
            counts.append(interruption.count)
        return Ran(over / "run.mcap")

    monkeypatch.setattr(timing_command, "measured_run", ended)
    monkeypatch.setattr(
        timing_command, "report_on", lambda _: (replace(report(), interrupted=True), ())
    )
    document = over / "x.json"
    result = timed("--json", document, "--duration", "1", "--out", over / "run")
    assert counts == [1]
    assert "PASS: all " in result.stdout
    assert json.loads(document.read_bytes())["interrupted"]
    assert result.exit_code == status


@pytest.mark.parametrize(("signum", "status"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_while_the_tables_are_printed_cuts_nothing(
    signum: signal.Signals, status: int, over: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def signalled(_: object) -> tuple[TimingReport, tuple[()]]:
        signal.raise_signal(signum)
        return report(), ()

    monkeypatch.setattr(timing_command, "report_on", signalled)
    result = timed("--duration", "1", "--out", over / "run")
    assert "PASS: all " in result.stdout
    assert result.stderr == ""
    assert result.exit_code == status


@pytest.mark.parametrize(
    ("while_in", "told"),
    [
        ("measured_run", "interrupted; the processes were ended by force"),
        ("report_on", "interrupted"),
    ],
)
def test_that_processes_were_ended_by_force_is_told_only_where_it_is_true(
    while_in: str, told: str, over: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted_twice(*_: object) -> None:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(timing_command, while_in, interrupted_twice)
    result = timed("--duration", "1", "--out", over / "run")
    assert result.stderr == f"heliarch: {told}\n"
    assert result.exit_code == 130


def test_a_signal_during_a_sweep_keeps_the_rates_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ended(preparation: Preparation, *_: object) -> Ran:
        if preparation.plan.cycle_wall_ns < 200_000_000:
            signal.raise_signal(signal.SIGTERM)  # Before there is a cycle to be ended.
        return Ran(tmp_path / "run.mcap")

    monkeypatch.setattr(trials, "measured_run", ended)
    monkeypatch.setattr(trials, "report_on", lambda _: (replace(report(), rate_hz=5.0), ()))
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
    def full(*_: object) -> Ran:
        raise OSError(28, "No space left on device", "run/plan.json")

    monkeypatch.setattr(timing_command, "measured_run", full)
    result = timed("--duration", "1", "--out", over / "run")
    assert result.stderr == "heliarch: run/plan.json: No space left on device\n"
    assert result.exit_code == 1
