"""A file that cannot be written is told, and nobody finds half of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from launch_scripts.timing.lasting_files import write_or_tell

FULL = Path("/dev/full")


def test_a_file_is_written_over_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(b"longer than what comes")
    assert write_or_tell(path, b"{}") == ""
    assert path.read_bytes() == b"{}"
    assert list(tmp_path.iterdir()) == [path]


def test_why_a_file_cannot_be_written_is_told_with_its_name(tmp_path: Path) -> None:
    path = tmp_path / "absent" / "x.json"
    assert write_or_tell(path, b"{}") == f"{path}: No such file or directory"


@pytest.mark.skipif(not FULL.exists(), reason="this system has no device that is full")
def test_of_a_full_disk_there_is_no_half_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert write_or_tell(FULL, b"{}") == f"{FULL}: No space left on device"
    path = tmp_path / "x.json"
    path.write_bytes(b"before")

    def fill(unfinished: Path, document: bytes) -> int:
        unfinished.touch()
        return FULL.open("wb", buffering=0).write(document) or 0

    monkeypatch.setattr(Path, "write_bytes", fill)
    assert write_or_tell(path, b"{}") == f"{path}: No space left on device"
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == b"before"
