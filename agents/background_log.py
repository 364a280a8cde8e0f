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
    """

    def __init__(self, queue: Queue[Any]) -> None:
        super().__init__(queue)
        self._records = queue

    def emit(self, record: logging.LogRecord) -> None:
        """Hand a record to the listener; wait until it is written if it is an error."""
        super().emit(record)
        if record.levelno >= logging.ERROR:
            self.flush()

    def flush(self) -> None:
        """Wait until all records are written."""
        done = self._records.all_tasks_done
        with done:
            done.wait_for(lambda: not self._records.unfinished_tasks, _LONGEST_FLUSH_S)


def log_in_background() -> None:
    """Let a thread of its own write what goes to the root logger's handlers from now on."""
    root = logging.getLogger()
    records: Queue[Any] = Queue()
    listener = QueueListener(records, *root.handlers, respect_handler_level=True)
    root.handlers = [BackgroundHandler(records)]
    listener.start()
