"""Recordings of runs: recorder, reader, inspect, verify, replay, export, recover."""

from recordings.read.reader import RunReader, open_run

__all__ = ["RunReader", "open_run"]
