"""A full disk ends the recording, once and with a reason, and not the run."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest
from command_line import python

_PROGRAM = """
import resource, sys, time
from pathlib import Path
from recordings_by_hand import PLAN, SCENARIO, whole_run
from bus_schemas.codec import encode

from recordings.read.reader import RunReader
from recordings.record.writer import RunWriter

path, most = Path(sys.argv[1]), int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
told = []
writer = RunWriter(path, PLAN, SCENARIO, "simulate", on_end=told.append)
for number, (port, message) in enumerate(whole_run(200)):
    writer.add(port, message, encode(message), time.monotonic_ns())
    if number % 300 == 0:
        writer.flush()
writer.close()
with RunReader(path) as run:
    found = sum(1 for _ in run.records())
    print(len(told), writer.heard, writer.recorded.total(), found, run.whole)
print(writer.trouble)
"""


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="no limit on the size of files")
def test_a_file_that_cannot_grow_ends_the_recording_and_not_its_writer(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    figures, trouble = python(_PROGRAM, path, "100000").stdout.splitlines()
    times, heard, recorded, found, whole = figures.split()
    assert trouble.startswith("the recording ended in cycle ")
    assert trouble.endswith(f"{path}: File too large")
    assert times == "1"
    assert 0 < int(recorded) == int(found) < int(heard)
    assert whole == "False"
