"""The log of dropped messages."""

from __future__ import annotations

import logging

from bus_schemas.printable import printable

log = logging.getLogger(__name__)


def log_drop(count: int, text: str) -> None:
    """Log the first ten dropped messages of a kind, then the 16th, 32nd, 64th and so on."""
    if count <= 10 or count & (count - 1) == 0:
        log.warning("dropped (%d of this kind): %s", count, printable(text))
