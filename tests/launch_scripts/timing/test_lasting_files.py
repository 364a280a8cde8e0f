"""A file that cannot be written is told, and nobody finds half of it."""

from __future__ import annotations

import resource
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
def test_that_a_device_is_full_is_told_with_its_name() -> None:
    assert write_or_tell(FULL, b"{}") == f"{FULL}: No space left on device"


def test_what_a_link_leads_to_is_written_and_the_link_stays(tmp_path: Path) -> None:
    kept, link = tmp_path / "kept.json", tmp_path / "link.json"
    kept.touch()
    link.symlink_to(kept)
    assert write_or_tell(link, b"{}") == ""
    assert link.is_symlink()
    assert kept.read_bytes() == b"{}"


def test_of_a_full_disk_there_is_no_half_file(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(b"before")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))  # As a disk that fills up.
    try:
        told = write_or_tell(path, b"more than ten bytes")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert told == f"{path}: File too large"
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == b"before"
