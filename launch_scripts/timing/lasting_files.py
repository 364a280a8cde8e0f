"""Files of a measurement that is over: one that cannot be written is told, and costs no other."""

from __future__ import annotations

from pathlib import Path

from recordings.whole_file import whole_file


def write_or_tell(path: Path, document: bytes) -> str:
    """Write a file, of which nobody finds half, see `whole_file`.

    Returns
    -------
    str
        Why it could not be written; empty if it was.
    """
    try:
        with whole_file(path) as file:
            file.write(document)
    except OSError as error:
        return f"{path}: {error.strerror}"
    return ""
