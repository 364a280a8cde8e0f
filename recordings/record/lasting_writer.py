"""A recording that may end before its run does: a full disk ends the recording, not the plant."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from recordings.read.reader import RunReader
from recordings.record.writer import Numbered, RunWriter


class LastingWriter:
    """Writes a run down for as long as that is possible.

    Once the file cannot be written any more, what comes is counted and not kept. The file then
    ends as if it had been cut: it is read up to there, and `heliarch recover` makes it whole.

    Parameters
    ----------
    writer
        The file.
    on_end
        Called once, with a line of text, when the recording has to end.

    Attributes
    ----------
    heard
        Messages that should have been written.
    recorded
        Messages that were, by signal. Of a recording that had to end, `close` counts them in the
        file itself: nobody else knows what of the last ones arrived there.
    trouble
        Why the recording ended, empty while it goes on.
    """

    def __init__(self, writer: RunWriter, on_end: Callable[[str], None]) -> None:
        self.heard = 0
        self.recorded = writer.recorded
        self.trouble = ""
        self._writer = writer
        self._on_end = on_end
        self._cycle = 0

    def add(self, port: Port[Message], head: Numbered, payload: bytes, logged_ns: int) -> None:
        """Write one message, see `RunWriter.add`."""
        self.heard += 1
        self._cycle = head.cycle
        if not self.trouble:
            try:
                self._writer.add(port, head, payload, logged_ns)
            except OSError as error:
                self._end(error)

    def flush(self) -> None:
        """Hand all that was added to the operating system."""
        if not self.trouble:
            try:
                self._writer.flush()
            except OSError as error:
                self._end(error)

    def close(self) -> None:
        """Write the index and close the file."""
        if not self.trouble:
            try:
                self._writer.close()
            except OSError as error:
                self._end(error)
        if self.trouble:
            self.recorded = _count(self._writer.path)

    def _end(self, error: OSError) -> None:
        self.trouble = (
            f"the recording ended in cycle {self._cycle:,}: {self._writer.path}: {error.strerror}"
        )
        self._writer.abandon()
        self._on_end(self.trouble)


def _count(path: Path) -> Counter[str]:
    """Count the messages in a recording, by signal; none in one that says nothing."""
    try:
        with RunReader(path) as run:
            return Counter(record.port.signal.name for record in run.records())
    except InputError:
        return Counter()
