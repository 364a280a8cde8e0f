"""The folder that a run leaves behind."""

from __future__ import annotations

import os
import secrets
from datetime import datetime
from pathlib import Path

from agents.plan import RunPlan, changed
from bus_schemas.errors import FailureError, InputError
from bus_schemas.whole_file import named_in_errors, whole_file
from recordings.read.run_file import FAILURE_NAME, RECORDING_NAME, SUMMARY_NAME, further_files
from scenarios.preparation import Preparation, RunOptions, prepare
from scenarios.scenario import ScenarioFile
from sim_plant.profile import PROFILE_NAME


class RunFolder:
    """Where the files of one run lie."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.plan = path / "plan.json"
        self.logs = path / "logs"
        self.recording = path / RECORDING_NAME
        self.summary = path / SUMMARY_NAME
        self.failure = path / FAILURE_NAME

    def make(self) -> None:
        try:
            self.logs.mkdir(parents=True)
        except FileExistsError:
            got = f"got {self.path}, in which another run has begun"
            raise InputError.of("--out", f"expected a new or empty folder, {got}") from None
        except OSError as error:
            got = f"got {self.path}: {error.strerror}"
            raise InputError.of("--out", f"expected a folder that can be made, {got}") from None

    def fill(
        self, preparation: Preparation, tcp_ports: dict[str, int], sockets: str = ""
    ) -> RunPlan:
        """Write what the processes need; return the plan with its ports.

        The plan comes last: a device may be waiting for it to appear.
        """
        self.make()
        plan = changed(preparation.plan, access={"tcp_ports": tcp_ports, "sockets": sockets})
        with named_in_errors(self.path):
            preparation.profile.save(self.path / PROFILE_NAME)
            (self.path / "scenario.toml").write_text(preparation.scenario.text, encoding="utf-8")
            self.write_plan(plan)
        return plan

    def remove_recording(self) -> None:
        for path in (self.recording, *(path for _, path in further_files(self.recording))):
            path.unlink(missing_ok=True)

    def write_summary(self, document: bytes) -> None:
        if not self.path.is_dir():
            raise FailureError(
                f"{self.path}: the run's folder has been removed, with its recording"
            )
        with whole_file(self.summary) as file:
            file.write(document + b"\n")

    def write_plan(self, plan: RunPlan) -> None:
        with whole_file(self.plan, mode=0o600) as file:
            file.write(plan.as_json())


def new_run_id(scenario: str) -> str:
    return f"{scenario}-{datetime.now():%Y%m%d-%H%M%S}-{secrets.token_hex(4)}"


def run_folder(run_id: str, out: Path | None) -> RunFolder:
    """Choose the folder of a run; do not make it yet."""
    path = out or Path("runs") / run_id
    if os.path.lexists(path) and (not path.is_dir() or any(path.iterdir())):
        raise InputError.of(
            "--out", f"expected a new or empty folder, got {path}, which exists already"
        )
    parent = next(folder for folder in path.absolute().parents if folder.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        raise InputError.of("--out", f"expected a folder in which {path} can be made, got {parent}")
    return RunFolder(path)


def prepare_run(
    file: ScenarioFile, options: RunOptions, out: Path | None = None
) -> tuple[Preparation, RunFolder]:
    """Prepare a run and choose its folder; write nothing yet."""
    run_id = new_run_id(file.scenario.name)
    folder = run_folder(run_id, out)
    return prepare(file, options, run_id, keeps=True), folder
