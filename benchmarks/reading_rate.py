"""How fast a recording is read: by the mcap library, by Heliarch, and one minute of it.

`python benchmarks/reading_rate.py RUN`, with the folder of a run or its MCAP file.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from mcap.reader import make_reader

from recordings import open_run
from recordings.read.chunks import messages_in


def measure(what: str, messages: Callable[[], Iterable[object]]) -> None:
    """Read messages to their end; print how many, the processor time, and the memory so far."""
    began_at = time.process_time()
    count = sum(1 for _ in messages())
    took_s = time.process_time() - began_at
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(
        f"{what:28} {count:>11,} messages {took_s:8.3f} s {count / took_s:>11,.0f} /s "
        f"{peak_mb:5.0f} MB"
    )


def main() -> None:
    """Measure one recording; the library last, since it takes the most memory."""
    with open_run(Path(sys.argv[1])) as run:
        middle = run.last_cycle // 2
        minute = range(middle, middle + round(60e9 / run.plan.cycle_ns))
        measure("one minute", lambda: run.on(run.ports(), minute))
        measure(
            "all, taken out of the chunks",
            lambda: (
                raw
                for place in run.outline.chunks
                for raw in messages_in(run.unpack(place), run.outline.channels)
            ),
        )
        measure("all, with their cycles", run.records)
        measure("all, typed", run.messages)
        with run.path.open("rb") as file:
            measure("all, by the mcap library", lambda: make_reader(file).iter_messages())


if __name__ == "__main__":
    main()
