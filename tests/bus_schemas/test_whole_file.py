"""A file or folder is there whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from bus_schemas.errors import InputError
from bus_schemas.whole_file import new_path, whole_file


def test_a_file_is_replaced_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(b"longer than the new one")
    with whole_file(path) as file:
        file.write(b"{}")
        file.flush()
        assert path.read_bytes() == b"longer than the new one"
    assert path.read_bytes() == b"{}"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("opened", [whole_file, new_path])
@pytest.mark.parametrize(
    "ending", [OSError(28, "No space left on device"), KeyboardInterrupt(), SystemExit(143)]
)
def test_an_interruption_leaves_all_as_it_was(
    tmp_path: Path,
    opened: Callable[[Path], AbstractContextManager[object]],
    ending: BaseException,
) -> None:
    path = tmp_path / "x.json"
    if opened is whole_file:
        path.write_bytes(b"before")
    before = {found: found.read_bytes() for found in tmp_path.iterdir()}

    def write_half() -> None:
        with opened(path) as beside:
            if isinstance(beside, Path):
                beside.mkdir()
                (beside / "half").write_text("half")
            raise ending

    with pytest.raises(type(ending)) as caught:
        write_half()
    if isinstance(caught.value, OSError):
        assert caught.value.filename == str(path), "an error of the disk alone names no file"
    assert {found: found.read_bytes() for found in tmp_path.iterdir()} == before


def test_a_link_stays_one_and_its_target_is_written(tmp_path: Path) -> None:
    kept, link = tmp_path / "kept.json", tmp_path / "link.json"
    kept.write_bytes(b"longer than the new one")
    link.symlink_to(kept)
    with whole_file(link) as file:
        file.write(b"{}")
    assert link.is_symlink()
    assert kept.read_bytes() == b"{}"


@pytest.mark.parametrize("meanwhile", [True, False])
def test_a_new_path_replaces_nothing(tmp_path: Path, meanwhile: bool) -> None:
    path = tmp_path / "export.mcap"
    if not meanwhile:
        path.write_text("theirs")

    def make() -> None:
        with new_path(path) as beside:
            beside.write_text("mine")
            path.write_text("theirs")

    with pytest.raises(InputError, match=str(path)):
        make()
    assert path.read_text() == "theirs"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_is_replaced_keeps_its_permissions_and_is_synced_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, synced = tmp_path / "secret.json", []
    path.touch(0o600)
    monkeypatch.setattr(os, "fsync", lambda number: synced.append(path.read_bytes()))
    with whole_file(path) as file:
        file.write(b"new")
    assert path.stat().st_mode & 0o777 == 0o600
    assert (synced, path.read_bytes()) == ([b""], b"new")
