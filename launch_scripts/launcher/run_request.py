"""What the user asks of a run: from options to a prepared run and its folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from launch_scripts.launcher.run_folder import RunFolder, new_run_id, run_folder
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import ScenarioFile


@dataclass(frozen=True, slots=True)
class RunRequest:
    """A scenario, what is different from it, and the folder of the run (None: a new one)."""

    scenario: ScenarioFile
    options: RunOptions
    out: Path | None = None


def prepare_run(request: RunRequest) -> tuple[Preparation, RunFolder]:
    """Work out the run and the path of its folder; write nothing yet."""
    run_id = new_run_id(request.scenario.scenario.name)
    folder = run_folder(run_id, request.out)
    return prepare(request.scenario, request.options, run_id), folder
