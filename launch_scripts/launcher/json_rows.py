"""Rows of figures as one JSON list, written as they come: a long list needs no memory."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import BinaryIO

import msgspec

from recordings.read.whole_file import whole_file


class JsonRows:
    """A JSON list under way, a row a line; without a file it goes nowhere."""

    def __init__(self, file: BinaryIO | None) -> None:
        self._file = file
        self._between = b"[\n"

    def write(self, row: msgspec.Struct) -> None:
        """Add a row."""
        if self._file is not None:
            self._file.write(self._between + msgspec.json.encode(row))
            self._between = b",\n"

    def finish(self) -> None:
        """End the list."""
        if self._file is not None:
            self._file.write(b"[]\n" if self._between == b"[\n" else b"\n]\n")
            self._file.flush()


@contextmanager
def json_rows(destination: str | None) -> Iterator[JsonRows]:
    """Give a list for `--json`. A file gets its name when the list is complete."""
    place: AbstractContextManager[BinaryIO | None]
    if destination in (None, "-"):
        place = nullcontext(sys.stdout.buffer if destination == "-" else None)
    else:
        place = whole_file(Path(str(destination)))
    with place as file:
        rows = JsonRows(file)
        yield rows
        rows.finish()
