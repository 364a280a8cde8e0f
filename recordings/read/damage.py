"""One line about what is missing when a reader has skipped damaged chunks."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from recordings.read.chunks import ChunkPlace
from recordings.read.reader import RunReader

_NAMED: Final = 3
"""So many chunks are named, the rest is counted."""


def damage_text(run: RunReader) -> str:
    """Say which chunks a reading has skipped, and which attachments are damaged; empty: none."""
    chunks = run.outline.chunks
    parts = [
        f"chunk at byte {place.offset:,}, {_cycles(run, chunks[:n], chunks[n + 1 :])}"
        for n, place in enumerate(chunks)
        if place.offset in run.damage
    ]
    if len(parts) > _NAMED:
        parts[_NAMED:] = [f"and {len(parts) - _NAMED:,} more chunks"]
    parts += [f"attachment {name}" for name in run.outline.damaged_attachments]
    if not parts:
        return ""
    return f"{run.path}: a part of the file is damaged ({'; '.join(parts)}): see heliarch recover"


def _cycles(run: RunReader, before: list[ChunkPlace], behind: list[ChunkPlace]) -> str:
    """Say of which cycles messages are missing between some chunks and others."""
    last, first = _nearest(run, reversed(before)), _nearest(run, behind)
    begin = last.stop - 1 if last is not None else 0
    if first is None:
        return f"messages from cycle {begin:,} on are missing"
    return f"cycles {begin:,} to {max(begin, first.start):,} missing"


def _nearest(run: RunReader, places: Iterable[ChunkPlace]) -> range | None:
    """Return the cycles of the first readable chunk."""
    found = (run.cycles_in(place) for place in places)
    return next((cycles for cycles in found if cycles is not None), None)
