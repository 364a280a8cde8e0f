"""Files of a measurement that is over: JSON and page. One that cannot be written costs no other."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from launch_scripts.exit_status import FAILED, complain
from recordings.read.whole_file import whole_file


def write_files(
    json: str | None, document: Callable[[], bytes], page: Path | None, html: Callable[[], str]
) -> list[str]:
    """Write JSON and page, if they are wanted; return why one could not be written.

    To be called before anything is printed: who reads that may leave.

    Parameters
    ----------
    json
        What followed `--json`: a path, `-` for standard output, or None.
    document
        Gives the JSON.
    page, html
        The page and what gives it; None: no page.
    """
    files: list[tuple[Path, Callable[[], bytes]]] = []
    if json == "-":
        sys.stdout.write(document().decode() + "\n")
    elif json is not None:
        files.append((Path(json), lambda: document() + b"\n"))
    if page is not None:
        files.append((page, lambda: html().encode()))
    unwritten = []
    for path, content in files:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(path) as file:
                file.write(content())
        except OSError as error:
            unwritten.append(f"{path}: {error.strerror}")
    return unwritten


def concluded(status: int, unwritten: Iterable[str]) -> int:
    """Return the exit status: a measurement of which something was not written is no success."""
    for text in unwritten:
        status = complain(f"not written: {text}", status or FAILED)
    return status
