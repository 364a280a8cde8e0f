"""Golden recordings: short simulated runs that the agents must repeat.

`heliarch verify --accept` records a run again with its own plan and profile, so that sky and
clusters stay as they are. `make golden` simulates all golden runs from their scenarios.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from agents.plan import RunPlan
from bus_schemas.codec import encode
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from launch_scripts.launcher.simulation import MemoryRun
from recordings.read.reader import RunReader
from recordings.read.run_file import RECORDING_NAME
from recordings.record.writer import RunWriter
from recordings.verify.verification import PROFILE_NAME, run_profile
from sim_plant.profile import Profile

GOLDEN: Final = Path(__file__).parents[1] / "golden"

RUNS: Final = {
    "oahu-predictive": "oahu --duration 24s",
    "oahu-limit": "oahu --actuator limit --duration 20s",
    "oahu-day-paper": "oahu-day --scheme paper --from 12:13:08 --duration 16s",
    "valley-periods": f"{GOLDEN / 'valley-periods.toml'} --duration 8s",
}
"""Arguments of `heliarch simulate` for each golden run."""


def main() -> None:
    """Simulate each golden run; keep its recording, and the profile for the plant."""
    for name, arguments in RUNS.items():
        with tempfile.TemporaryDirectory() as scratch:
            run = Path(scratch) / "run"
            command = ["-m", "launch_scripts", "simulate", *arguments.split(), "--out", str(run)]
            subprocess.run([sys.executable, *command], check=True, stdout=subprocess.DEVNULL)
            (GOLDEN / name).mkdir(exist_ok=True)
            for file in (RECORDING_NAME, PROFILE_NAME):
                shutil.move(run / file, GOLDEN / name / file)
        sys.stdout.write(f"{GOLDEN / name}\n")


def origin(run: Path) -> tuple[Path, RunPlan, str, Profile]:
    """Return what it takes to record a run again: recording, plan, scenario and profile."""
    with RunReader(run) as reader:
        path, plan, scenario = reader.path, reader.plan, reader.scenario
        driver = reader.metadata["run"].get("driver", "")
    if not plan.lockstep or driver != "simulate":
        mode = "in lockstep" if plan.lockstep else "in real time"
        raise InputError(
            f"--accept {path}: expected a run of `heliarch simulate` in lockstep, got one of "
            f"{driver} {mode}"
        )
    profile = run_profile(plan, path)
    if profile is None:
        raise InputError(f"--accept {path}: expected {PROFILE_NAME} beside it, got none")
    return path, plan, scenario, profile


def record_again(run: Path) -> None:
    """Simulate a recorded run again; replace its recording once the new one is complete."""
    path, plan, scenario, profile = origin(run)
    unfinished = path.with_name(f"{path.name}.unfinished")
    writer = RunWriter(unfinished, plan, scenario, driver="simulate")

    def record(port: Port[Message], message: Message) -> None:
        if port.signal.logged:
            writer.add(port, message, encode(message), message.publish_time_ns)

    try:
        memory_run = MemoryRun(plan, profile, record)
        for _ in memory_run.cycles():
            pass
        memory_run.close()
        writer.close()
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
