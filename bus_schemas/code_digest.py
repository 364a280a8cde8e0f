"""A digest of the code that decides, so that a recording names the code that made it."""

from __future__ import annotations

from functools import cache
from hashlib import sha256
from pathlib import Path

_DECIDING = "agents", "bus_schemas", "sim_plant"


@cache
def code_digest() -> str:
    """Return a digest of the sources of agents, messages and plant, as installed here."""
    home, digest = Path(__file__).parents[1], sha256()
    for folder in _DECIDING:
        for path in sorted((home / folder).rglob("*.py")):
            digest.update(path.relative_to(home).as_posix().encode() + b"\0")
            digest.update(path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]
