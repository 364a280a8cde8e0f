"""A run that is over is kept, whatever comes while the floor beside it is gathered."""

from __future__ import annotations

import io
import signal
from pathlib import Path

import pytest
from rich.console import Console
from timings_by_hand import summary_of

from launch_scripts.preparation import Preparation, RunOptions, prepare
from launch_scripts.run_folder import run_folder
from launch_scripts.scenario import load_scenario
from launch_scripts.timing import measured_run
from launch_scripts.timing.floor import FloorTimes
from launch_scripts.timing.measured_run import MeasuredRun


class FloorByHand:
    """Stands in for the probes: a signal comes while they are asked for their figures."""

    signum: int | None = None

    def __init__(self, *_: object) -> None:
        pass

    def __enter__(self) -> FloorByHand:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def begin(self, duration_s: float) -> None:
        """Nothing is measured."""

    def finish(self) -> tuple[FloorTimes, ...]:
        if self.signum is not None:
            signal.raise_signal(self.signum)
        return (FloorTimes("timer", None, "by hand"),)


@pytest.fixture
def preparation() -> Preparation:
    return prepare(load_scenario("oahu"), RunOptions("12:30", "2s", pace=1.0), "by-hand")


def measured(
    preparation: Preparation, folder: Path, monkeypatch: pytest.MonkeyPatch, signum: int | None
) -> tuple[MeasuredRun, str]:
    console = Console(file=io.StringIO(), width=100)
    monkeypatch.setattr(FloorByHand, "signum", signum)
    monkeypatch.setattr(measured_run, "Floor", FloorByHand)
    monkeypatch.setattr(measured_run, "launch", lambda *_: summary_of(folder, interrupted=False))
    run = measured_run.measured_run(preparation, run_folder("by-hand", folder), console)
    assert isinstance(console.file, io.StringIO)
    return run, console.file.getvalue()


@pytest.mark.parametrize(("signum", "interrupted"), [(None, False), (signal.SIGINT, True)])
def test_ctrl_c_after_the_run_ends_the_rest_and_loses_nothing(
    signum: int | None,
    interrupted: bool,
    preparation: Preparation,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run, said = measured(preparation, tmp_path, monkeypatch, signum)
    assert run.summary.interrupted is interrupted
    assert [row.name for row in run.floor] == ["timer"]
    assert run.unwritten == ""
    assert (tmp_path / "summary.json").exists()
    assert "1 cycle/s for 2 s\n" in said


def test_a_summary_that_cannot_be_written_costs_no_measurement(
    preparation: Preparation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "absent"
    run, _ = measured(preparation, folder, monkeypatch, None)
    assert run.unwritten == f"{folder / 'summary.json'}: No such file or directory"
    assert run.summary.cycles == 3
