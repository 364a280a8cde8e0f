"""A log that is written behind the back of the loop: a thread of its own does the writing.

A line on its way to a file can take as long as a cycle when the disk is busy. What must not be lost
is written before the loop goes on: errors at once, the rest when the process ends, in order or not.
"""

from __future__ import annotations

import logging
from logging.handlers import QueueHandler, QueueListener
from queue import Queue
from typing import Any, Final

_LONGEST_FLUSH_S: Final = 2.0
"""A process that ends waits so long at most for its last lines to be written."""


class BackgroundHandler(QueueHandler):
    """Puts records into a queue, and waits for them to be written where that matters.

    The logging module flushes its handlers when the interpreter ends, so all is written then.

    Parameters
    ----------
    queue
        From which a listener writes.
    longest_flush_s
        How long to wait at most.
    """

    def __init__(self, queue: Queue[Any], longest_flush_s: float) -> None:
        super().__init__(queue)
        self._records = queue
        self._longest_flush_s = longest_flush_s

    def emit(self, record: logging.LogRecord) -> None:
        """Hand a record to the listener; wait until it is written if it is an error."""
        super().emit(record)
        if record.levelno >= logging.ERROR:
            self.flush()

    def flush(self) -> None:
        """Wait until all records are written."""
        done = self._records.all_tasks_done
        with done:
            done.wait_for(lambda: not self._records.unfinished_tasks, self._longest_flush_s)


def log_in_background(longest_flush_s: float = _LONGEST_FLUSH_S) -> None:
    """Let a thread of its own write what goes to the root logger's handlers from now on.

    Parameters
    ----------
    longest_flush_s
        How long whoever must not lose a line waits for it to be written.
    """
    root = logging.getLogger()
    records: Queue[Any] = Queue()
    listener = QueueListener(records, *root.handlers, respect_handler_level=True)
    root.handlers = [BackgroundHandler(records, longest_flush_s)]
    listener.start()
