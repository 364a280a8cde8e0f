"""The log of dropped messages: the first few of a kind, then fewer and fewer."""

from __future__ import annotations

import logging
from collections import Counter
from typing import Final

from bus_schemas.printable import printable

log = logging.getLogger(__name__)

_WITHOUT_DIGITS: Final = str.maketrans("", "", "0123456789")
_MOST_KINDS: Final = 200


class DropLog:
    """Logs dropped messages: the first ten of a kind, then the 16th, 32nd, 64th and so on.

    Two texts are of a kind if they differ only in digits. A flood of one kind does not hide
    another.
    """

    def __init__(self) -> None:
        self.total = 0
        self._of_kind: Counter[str] = Counter()

    def __call__(self, text: str) -> None:
        """Count a drop, and log it if it is due."""
        self.total += 1
        kind = text.translate(_WITHOUT_DIGITS)
        if kind not in self._of_kind and len(self._of_kind) >= _MOST_KINDS:
            kind = ""
        self._of_kind[kind] += 1
        count = self._of_kind[kind]
        if count <= 10 or count & (count - 1) == 0:
            log.warning("dropped (%d so far): %s", self.total, printable(text))
