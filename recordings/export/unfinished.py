"""Output that is there whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bus_schemas.errors import InputError


def check_new(path: Path) -> None:
    """Refuse a place where nothing new can be put.

    Raises
    ------
    InputError
        Something is there already, or the folder that it would be in is not.
    """
    if path.exists() or path.is_symlink():
        raise InputError(f"--out {path}: it exists already, accepted is a new name")
    if not path.absolute().parent.is_dir():
        raise InputError(f"--out {path}: accepted is a new name in an existing folder")


@contextmanager
def unfinished(path: Path) -> Iterator[Path]:
    """Give a name beside a path to write to, a file or a folder; at the end it gets that path.

    If the end is an error or Ctrl-C, what has been written vanishes.

    Raises
    ------
    InputError
        See `check_new`; also if somebody else has put something there meanwhile.
    """
    check_new(path)
    beside = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        yield beside
        check_new(path)
        beside.rename(path)
    finally:
        if beside.is_dir():
            shutil.rmtree(beside)
        else:
            beside.unlink(missing_ok=True)
