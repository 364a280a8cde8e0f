"""Rows of figures as one JSON list, written as they come: a long list needs no memory."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import msgspec

from bus_schemas.errors import InputError
from recordings.read.whole_file import whole_file


class JsonRows:
    """A JSON list under way, a row a line.

    Parameters
    ----------
    file
        Where it goes; None: nowhere.
    """

    def __init__(self, file: BinaryIO | None) -> None:
        self._file = file
        self._begun = False

    def write(self, row: msgspec.Struct) -> None:
        """Add a row."""
        if self._file is not None:
            self._file.write((b",\n" if self._begun else b"[\n") + msgspec.json.encode(row))
            self._begun = True

    def finish(self) -> None:
        """End the list."""
        if self._file is not None:
            self._file.write(b"\n]\n" if self._begun else b"[]\n")
            self._file.flush()


@contextmanager
def json_rows(destination: str | None) -> Iterator[JsonRows]:
    """Give a list to add rows to. A file gets its name when the list is complete.

    Parameters
    ----------
    destination
        What followed `--json`: a path, `-` for standard output, or None.
    """
    if destination in (None, "-"):
        rows = JsonRows(sys.stdout.buffer if destination == "-" else None)
        yield rows
        rows.finish()
        return
    with whole_file(Path(str(destination))) as file:
        rows = JsonRows(file)
        yield rows
        rows.finish()


def check_json_destination(destination: str | None) -> None:
    """Refuse a place where no JSON can be written, before any work is done.

    Raises
    ------
    InputError
        It is a folder, or it lies in none.
    """
    if destination in (None, "-"):
        return
    path = Path(str(destination))
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise InputError(f"--json: expected a file in an existing folder, or -, got {path}")
