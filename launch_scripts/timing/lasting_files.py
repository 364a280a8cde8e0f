"""Files of a measurement that is over: one that cannot be written is told, and costs no other."""

from __future__ import annotations

import os
from pathlib import Path


def write_or_tell(path: Path, document: bytes) -> str:
    """Write a file, under another name first, so that nobody finds half of it.

    Returns
    -------
    str
        Why it could not be written; empty if it was.
    """
    try:
        if path.exists() and not path.is_file():
            path.write_bytes(document)  # A device or a pipe: it must not be replaced.
        else:
            _write_whole(path, document)
    except OSError as error:
        return f"{path}: {error.strerror}"
    return ""


def _write_whole(path: Path, document: bytes) -> None:
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        unfinished.write_bytes(document)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
