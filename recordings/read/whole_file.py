"""A file of which nobody finds half."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file to write to, under another name until it is complete.

    What is no plain file is written in place: a device, a pipe or a link must not be replaced.
    `/dev/stdout` is a link, which leads to a file where standard output goes to one.

    Raises
    ------
    OSError
        It cannot be written. A plain file stays as it was.
    """
    try:
        with _written(path) as file:
            yield file
    except OSError as error:  # That a disk is full is often found by a call that knows no name.
        raise OSError(error.errno, error.strerror, error.filename or str(path)) from None


@contextmanager
def _written(path: Path) -> Iterator[BinaryIO]:
    if path.is_symlink() or (path.exists() and not path.is_file()):
        with path.open("wb") as file:
            yield file
        return
    beside = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        with beside.open("wb") as file:
            yield file
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
