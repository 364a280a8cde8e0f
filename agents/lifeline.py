"""The line between a process of a run and the launcher that started it.

Events (`agents.events`) go out as lines of JSON on standard output; words come in on standard
input. The line needs no bus, so it works while the bus does not. When the launcher is gone, however
it died, standard input ends, and the process ends with it.
"""

from __future__ import annotations

import logging
import os
import sys
import threading
from collections.abc import Callable

import msgspec

from agents.events import Event

log = logging.getLogger(__name__)


def end_at_once() -> None:
    """End this process, whatever its other threads do; its last words are in its log."""
    logging.shutdown()
    os._exit(1)


class Lifeline:
    """A process's end of the line.

    Parameters
    ----------
    attached
        Whether a launcher holds the other end. Without one, events are printed all the same, and
        standard input is left alone: an agent can be run by hand.
    on_word
        Called, on a thread of its own, with each word that comes in.
    on_orphaned
        Called likewise when the launcher is gone.
    """

    def __init__(
        self,
        attached: bool,
        on_word: Callable[[str], None] = lambda word: None,
        on_orphaned: Callable[[], None] = end_at_once,
    ) -> None:
        self._encoder = msgspec.json.Encoder()
        self._lock = threading.Lock()
        self._on_word = on_word
        self._on_orphaned = on_orphaned
        if attached:
            threading.Thread(target=self._listen, name="lifeline", daemon=True).start()

    def tell(self, event: Event) -> None:
        """Send an event."""
        line = self._encoder.encode(event) + b"\n"
        with self._lock:
            try:
                sys.stdout.buffer.write(line)
                sys.stdout.buffer.flush()
            except BrokenPipeError:
                log.warning("nobody reads events any more")
                self._on_orphaned()

    def _listen(self) -> None:
        for line in sys.stdin:
            self._on_word(line.strip())
        log.warning("the launcher is gone")
        self._on_orphaned()
