"""A sweep keeps what it has measured, whatever becomes of a later rate."""

from __future__ import annotations

import io
import signal
from pathlib import Path
from typing import NamedTuple

import pytest
from msgspec.structs import replace
from rich.console import Console
from timings_by_hand import report

from bus_schemas.errors import InputError
from launch_scripts.preparation import Preparation
from launch_scripts.run_command import RunRequest
from launch_scripts.run_folder import RunFolder
from launch_scripts.scenario import load_scenario
from launch_scripts.supervision import RunFailure
from launch_scripts.termination import Termination, terminable
from launch_scripts.timing import trials
from launch_scripts.timing.rates import Rates
from launch_scripts.timing.sweep import sweep
from launch_scripts.timing.timing_report import TimingReport
from launch_scripts.timing.trials import Trials


class Ran(NamedTuple):
    """Stands in for a run that is over."""

    rate_hz: float
    unwritten: str


DEATH = RunFailure("c1 has died\nits log says so")


class Machine:
    """Stands in for the processes: each rate is clean, but one."""

    def __init__(
        self,
        fails_at_hz: float | None = None,
        failure: Exception = DEATH,
        unwritten: str = "",
    ) -> None:
        self.ran_hz: list[float] = []
        self._fails_at_hz = fails_at_hz
        self._failure = failure
        self._unwritten = unwritten

    def run(self, preparation: Preparation, folder: RunFolder, console: Console) -> Ran:
        rate_hz = round(1e9 / preparation.plan.cycle_wall_ns, 3)
        self.ran_hz.append(rate_hz)
        if rate_hz == self._fails_at_hz:
            raise self._failure
        return Ran(rate_hz, self._unwritten)


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    machine = Machine()
    monkeypatch.setattr(trials, "measured_run", machine.run)
    monkeypatch.setattr(
        trials, "report_on", lambda run: (replace(report([]), rate_hz=run.rate_hz), ())
    )
    return machine


def trials_in(folder: Path, termination: Termination | None = None) -> Trials:
    """Of a plant whose deadlines fit into cycles of 61 ms or more: up to 16 cycles a second."""
    path = folder / "stated.toml"
    path.write_text(
        load_scenario("oahu").text.replace(
            "\n[control]\n", "\n[control]\ndeadlines_ms = [20, 40, 60]\n"
        )
    )
    request = RunRequest(
        "launch", str(path), None, None, None, None, None, None, None, None, None, report=False
    )
    console = Console(file=io.StringIO())
    return Trials(request, "1", folder / "sweep", console, termination or Termination())


def test_a_rate_that_a_search_finds_refused_has_failed_and_those_before_count(
    machine: Machine, tmp_path: Path
) -> None:
    found = sweep(Rates(search_hz=(10.0, 20.0)), trials_in(tmp_path).run)
    assert machine.ran_hz == [10.0, 14.1, 15.4]
    assert found.highest_clean_hz == 15.4
    refused = {row.rate_hz: row.failed for row in found.rows if row.failed}
    assert sorted(refused) == [16.8, 20.0]
    assert "control.deadlines_ms[2] is 60 ms, accepted is less than the cycle" in refused[20.0]


def test_a_search_whose_first_rate_is_refused_is_refused(machine: Machine, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="accepted is less than the cycle"):
        sweep(Rates(search_hz=(30.0, 40.0)), trials_in(tmp_path).run)
    assert machine.ran_hz == []


def test_a_listed_rate_is_refused_before_the_first_one_runs(
    machine: Machine, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="accepted is less than the cycle"):
        trials_in(tmp_path).prepare((10.0, 20.0))
    assert machine.ran_hz == []


def test_a_run_that_fails_is_a_row_with_its_reason(
    machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing = Machine(fails_at_hz=10.0)
    monkeypatch.setattr(trials, "measured_run", failing.run)
    tried = trials_in(tmp_path)
    found = sweep(Rates(listed_hz=(10.0, 12.0)), tried.run)
    assert [row.failed for row in found.rows] == ["c1 has died", ""]
    assert failing.ran_hz == [10.0, 12.0]
    assert tried.latest is not None
    assert tried.latest.rate_hz == 12.0


def test_a_full_disk_costs_no_rate_that_was_measured(
    machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = Machine(12.0, OSError(28, "No space left on device"), "summary.json: full")
    monkeypatch.setattr(trials, "measured_run", full.run)
    tried = trials_in(tmp_path)
    found = sweep(Rates(listed_hz=(10.0, 12.0, 14.0)), tried.run)
    assert [row.failed for row in found.rows] == [
        "",
        f"{tmp_path / 'sweep'}: No space left on device",
        "",
    ]
    assert found.rows[1].outcome == "failed"
    assert [row.unwritable for row in found.rows] == [False, True, False]
    assert tried.unwritten == ["summary.json: full"] * 2


def test_a_run_whose_recording_cannot_be_read_costs_no_other(
    machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unreadable(run: Ran) -> object:
        if run.rate_hz == 12.0:
            raise RunFailure("run.mcap: no recording")
        return replace(report([]), rate_hz=run.rate_hz), ()

    monkeypatch.setattr(trials, "report_on", unreadable)
    found = sweep(Rates(listed_hz=(10.0, 12.0)), trials_in(tmp_path).run)
    assert [row.failed for row in found.rows] == ["", "run.mcap: no recording"]


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_after_the_last_cycle_costs_no_rate_its_figures_and_ends_the_sweep(
    signum: signal.Signals, machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def signalled(run: Ran) -> tuple[TimingReport, tuple[()]]:
        if run.rate_hz == 12.0:
            signal.raise_signal(signum)
        return replace(report([]), rate_hz=run.rate_hz), ()

    monkeypatch.setattr(trials, "report_on", signalled)
    with terminable() as termination:
        tried = trials_in(tmp_path, termination)
        found = sweep(Rates(listed_hz=(10.0, 12.0, 14.0)), tried.run)
        assert termination.status(0) == 128 + signum
    assert [(row.rate_hz, row.outcome) for row in found.rows] == [(10.0, "clean"), (12.0, "clean")]
    assert found.interrupted
    assert machine.ran_hz == [10.0, 12.0]
