"""Golden recordings: short simulated runs that the agents must repeat.

`make golden` records those that differ again, with their own plan and profile, so that sky and
clusters stay as they are.
"""

from __future__ import annotations

import sys
from pathlib import Path

from bus_schemas.codec import encode
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from launch_scripts.simulation import MemoryRun
from recordings.read.reader import RunReader
from recordings.record.writer import RunWriter
from recordings.verify.verification import run_profile, verify
from sim_plant.profile import PROFILE_NAME


def record_again(run: Path) -> None:
    """Simulate a recorded run again; replace its recording once the new one is complete."""
    with RunReader(run) as reader:
        path, plan, scenario = reader.path, reader.plan, reader.scenario
        driver = reader.metadata["run"].get("driver", "")
    if not plan.timing.lockstep or driver != "simulate":
        raise InputError(f"{path}: expected a run of `heliarch simulate` in lockstep")
    profile = run_profile(plan, path)
    if profile is None:
        raise InputError(f"{path}: expected {PROFILE_NAME} beside it, got none")
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
    for folder in sys.argv[1:]:
        if not verify(Path(folder)).equal:
            record_again(Path(folder))
