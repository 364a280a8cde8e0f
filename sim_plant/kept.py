"""Keeps what a sky brought, in the user's cache: the next run of the same scenario is ready sooner.

An answer is kept under a hash of its question, of this folder's code and of the versions of its
libraries, so it is never that of another question. It is read as it was written, to the last bit. A
cache that cannot be written, or is damaged, only costs time.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import msgspec
import numpy as np
import pandas as pd

from bus_schemas.whole_file import whole_file
from sim_plant import Floats

_LARGEST_MB: Final = 60
_MOST_MB: Final = 250
"""Of one answer, and of all; the longest unused make room for new ones."""

# What numpy and zipfile raise for a damaged file: RuntimeError, if it looks encrypted.
_UNREADABLE: Final = (OSError, ValueError, KeyError, EOFError, RuntimeError, BadZipFile)


def kept(times: pd.DatetimeIndex, *question: object, work_out: Callable[[], Floats]) -> Floats:
    """Return what was worked out for the same times and question before, or work it out."""
    asked = msgspec.msgpack.encode(question, enc_hook=np.ndarray.tobytes)
    when = times.as_unit("ns").asi8.tobytes()
    name = sha256(b"".join((_code(), len(asked).to_bytes(8), asked, when))).hexdigest()
    path = _folder() / f"{name}.npz"
    try:
        with np.load(path) as file:
            values: Floats = file["values"]
        os.utime(path)
    except _UNREADABLE:
        values = work_out()
        with suppress(OSError):
            _keep(path, values)
    return values


def _keep(path: Path, values: Floats) -> None:
    if values.nbytes > _LARGEST_MB * 1e6:
        return
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with whole_file(path) as file:
        np.savez(file, values=values)
    for old in _oldest(path.parent):
        old.unlink(missing_ok=True)


def _oldest(folder: Path) -> Iterator[Path]:
    """Yield the files for which there is no room, those that were used last having it."""
    sizes = {path: path.stat() for path in folder.glob("*.npz")}
    total = 0
    for path in sorted(sizes, key=lambda one: sizes[one].st_mtime, reverse=True):
        total += sizes[path].st_size
        if total > _MOST_MB * 1e6:
            yield path


def _folder() -> Path:
    cached = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(cached) if cached else Path.home() / ".cache") / "heliarch"


@cache
def _code() -> bytes:
    """Return a hash of all that answers: the code of the world, and its libraries."""
    found = sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        found.update(path.read_bytes())
    for library in ("numpy", "pandas", "pvlib", "scipy"):
        found.update(version(library).encode())
    return found.digest()
