"""A reader who leaves does not end what is under way."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import sys
from launch_scripts.lasting_console import LastingConsole, write_if_read
console = LastingConsole(stderr={stderr})
for number in range(20_000):
    {say}
open(sys.argv[1], "w").write("done")
sys.exit(3)
"""


@pytest.mark.parametrize(
    ("say", "stderr"),
    [
        ("console.print(number)", False),
        ("console.print(number)", True),
        ("write_if_read(f'{number}\\n')", False),
    ],
)
def test_the_work_goes_on_in_silence(tmp_path: Path, say: str, stderr: bool) -> None:
    path = tmp_path / "done"
    program = PROGRAM.format(say=say, stderr=stderr)
    with subprocess.Popen(
        [sys.executable, "-c", program, str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        read, other = process.stdout, process.stderr
        if stderr:
            read, other = other, read
        assert read is not None
        assert other is not None
        assert read.readline() == b"0\n"
        read.close()
        assert other.read() == b""
        assert process.wait() == 3
    assert path.read_text(encoding="ascii") == "done"
