"""Files that exist whole or not at all: they get their name when they are complete."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

from bus_schemas.errors import InputError

_UNFINISHED: Final = ".unfinished"


@contextmanager
def whole_file(path: Path, mode: int = 0o666) -> Iterator[BinaryIO]:
    """Open a file to write to, which replaces an older one when it is complete.

    It keeps the older file's permissions, and is on the disk when it gets its name. A device, a
    pipe or a link, such as `/dev/stdout`, is written in place.
    """
    with named_in_errors(path):
        if path.is_symlink() or (path.exists() and not path.is_file()):
            with path.open("wb") as file:
                yield file
            return
        with _beside(path) as beside:
            beside.touch(mode)
            if path.exists():
                beside.chmod(path.stat().st_mode & 0o777)
            with beside.open("wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)


@contextmanager
def named_in_errors(path: Path) -> Iterator[None]:
    """Name a path in errors that name none, or only a temporary name."""
    try:
        yield
    except OSError as error:
        why, name = error.strerror or str(error), str(error.filename or path)
        raise OSError(error.errno, why, str(path) if name.endswith(_UNFINISHED) else name) from None


def check_new(path: Path) -> None:
    """Refuse a place where nothing new can be put."""
    if path.exists() or path.is_symlink():
        raise InputError.of(f"--out {path}", "it exists already, expected a new name")
    if not os.access(path.absolute().parent, os.W_OK):
        raise InputError.of(
            f"--out {path}", "expected a new name in a folder that can be written to"
        )


@contextmanager
def new_path(path: Path) -> Iterator[Path]:
    """Give a name to write a new file or folder under; it gets `path` when it is complete."""
    check_new(path)
    with named_in_errors(path), _beside(path) as beside:
        yield beside
        check_new(path)
        beside.rename(path)


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """Give a temporary name in the same folder; at the end remove what has it."""
    beside = path.with_name(f".{path.name}.{os.getpid()}{_UNFINISHED}")
    try:
        yield beside
    finally:
        if beside.is_dir():
            shutil.rmtree(beside)
        else:
            beside.unlink(missing_ok=True)
