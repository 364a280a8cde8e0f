"""A file is there whole or not at all, and what is no plain file is not replaced by one."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from recordings.read.whole_file import whole_file


def write(path: Path, document: bytes) -> None:
    with whole_file(path) as file:
        file.write(document)


def test_a_file_is_replaced_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(b"longer than what comes")
    with whole_file(path) as file:
        file.write(b"{}")
        file.flush()
        assert path.read_bytes() == b"longer than what comes"
    assert path.read_bytes() == b"{}"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("end", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_of_what_is_cut_short_there_is_no_half_file(tmp_path: Path, end: BaseException) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(b"before")

    def cut_short() -> None:
        with whole_file(path) as file:
            file.write(b"half")
            raise end

    with pytest.raises(type(end)):
        cut_short()
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("exists", [True, False])
def test_a_link_stays_one_and_what_it_leads_to_is_written(tmp_path: Path, exists: bool) -> None:
    kept, link = tmp_path / "kept.json", tmp_path / "link.json"
    if exists:
        kept.write_bytes(b"longer than what comes")
    link.symlink_to(kept)
    write(link, b"{}")
    assert link.is_symlink()
    assert kept.read_bytes() == b"{}"


def test_a_pipe_stays_one_and_its_reader_gets_it(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read: list[bytes] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_bytes()))
    reader.start()
    write(pipe, b"{}")
    reader.join()
    assert read == [b"{}"]
    assert pipe.is_fifo()
