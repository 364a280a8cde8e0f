"""What is kept of a run: the recorder, the reader, and the figures that are drawn from it."""

from recordings.read.reader import RunReader, open_run

__all__ = ["RunReader", "open_run"]
