"""Neither a reader who leaves nor a full disk nor an old encoding ends what is under way."""

from __future__ import annotations

import os
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


def ran(program: str, stdout: Path | int, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """A program that has ended, with its output in a file or kept."""
    command = [sys.executable, "-c", program]
    environ = {**os.environ, **environment}
    if isinstance(stdout, int):
        return subprocess.run(command, stdout=stdout, stderr=-1, env=environ, check=False)
    with stdout.open("wb") as file:
        return subprocess.run(command, stdout=file, stderr=-1, env=environ, check=False)


FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.exists(), reason="this system has no device that is full")
def test_output_on_a_full_disk_is_told_once_and_the_work_goes_on() -> None:
    program = """
import sys
from launch_scripts.lasting_console import LastingConsole, write_if_read
console = LastingConsole()
console.print("a table")
console.print("a verdict")
assert console.lost == "stdout: No space left on device", console.lost
sys.exit(7)
"""
    ended = ran(program, FULL)
    assert ended.stderr == (
        b"heliarch: stdout: No space left on device; the rest of it is not shown\n"
    )
    assert ended.returncode == 7


@pytest.mark.skipif(not FULL.exists(), reason="this system has no device that is full")
def test_a_document_for_a_full_disk_tells_why_it_was_not_written() -> None:
    program = """
import sys
from launch_scripts.lasting_console import write_if_read
sys.stderr.write(write_if_read("{}"))
"""
    ended = ran(program, FULL)
    assert (ended.stderr, ended.returncode) == (b"stdout: No space left on device", 0)


def test_what_an_encoding_lacks_is_replaced_and_documents_stay_utf_8() -> None:
    program = """
from launch_scripts.lasting_console import LastingConsole, write_if_read
LastingConsole().print("hop [bold]\\\\[µs][/]: caf\u00e9")
assert write_if_read("µ") == ""
"""
    ended = ran(program, subprocess.PIPE, PYTHONIOENCODING="ascii", NO_COLOR="1")
    assert (ended.stderr, ended.returncode) == (b"", 0)
    assert ended.stdout == "hop [us]: caf?\nµ".encode()
