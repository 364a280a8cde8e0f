"""The table that says how a run fared: faults, lost and dropped messages, agents that left."""

from __future__ import annotations

from recordings.inspect.health import health_lines, read_health
from recordings.read.reader import RunReader
from recordings.read.run_clock import RunClock
from studies.tables import Table, key_column, word_column


def health_table(run: RunReader) -> Table:
    """Go through a recording and return how its run fared, a line for each thing looked at."""
    lines = health_lines(read_health(run), RunClock(run.plan, run.last_cycle))
    rows = tuple((name.capitalize(), text) for name, text in lines)
    return Table("Health of the run", (key_column("", "what"), word_column("", "found")), rows)
