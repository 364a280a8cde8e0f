"""`make golden`: simulates golden recordings that differ again, with their own plan and profile.

So sky and clusters stay as they are.
"""

from __future__ import annotations

import sys
from pathlib import Path

from bus_schemas.codec import encode
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from launch_scripts.simulation import MemoryRun
from recordings.read.reader import RunReader
from recordings.record.writer import RunWriter
from recordings.verify.verification import run_profile, verify


def record_again(run: Path) -> None:
    """Simulate a recorded run again, and replace its recording."""
    with RunReader(run) as reader:
        path, plan, scenario = reader.path, reader.plan, reader.scenario
    profile, unfinished = run_profile(plan, path), path.with_name("run.unfinished")
    assert profile is not None
    writer = RunWriter(unfinished, plan, scenario, driver="simulate")

    def record(port: Port[Message], message: Message) -> None:
        if port.signal.logged:
            writer.add(port, message, encode(message), message.publish_time_ns)

    memory_run = MemoryRun(plan, profile, record)
    for _ in memory_run.cycles():
        pass
    memory_run.close()
    writer.close()
    unfinished.replace(path)


if __name__ == "__main__":
    for folder in sys.argv[1:]:
        if not verify(Path(folder)).equal:
            record_again(Path(folder))
