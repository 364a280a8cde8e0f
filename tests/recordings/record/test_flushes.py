"""How often the recorder hands on what it has heard: a crash loses the rest."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle, pairwise
from pathlib import Path
from unittest.mock import Mock, patch

import pytest
from clock_by_hand import ClockByHand
from recordings_by_hand import PLAN, SCENARIO, whole_run

from bus_schemas.codec import encode
from recordings.record.recorder import FLUSH_S, Recorder, RecordingEnd
from recordings.record.writer import RunWriter

MESSAGE_S = 20e-6
"""What it takes to write a message down."""

LASTS_S = 10.0


@pytest.mark.parametrize("bursts_s", [0.0, 0.1])
def test_it_flushes_every_half_second(bursts_s: float, tmp_path: Path) -> None:
    clock = ClockByHand()
    began_ns = clock.now_ns
    ends_ns, bursts_ns = began_ns + round(LASTS_S * 1e9), round(bursts_s * 1e9)
    said = cycle((PLAN.keys.key(port), encode(message)) for port, message in whole_run(5))
    end = RecordingEnd()

    def drain() -> Iterator[tuple[str, bytes]]:
        """There is always one more message, or bursts of them, until the recording is to end."""
        while clock.now_ns < ends_ns:
            if bursts_ns and clock.now_ns // bursts_ns % 2:
                return
            clock.sleep(MESSAGE_S)
            yield next(said)
        end.ask()

    flushed_s: list[float] = []

    class NotedWriter(RunWriter):
        def flush(self) -> None:
            flushed_s.append((clock.now_ns - began_ns) / 1e9)
            super().flush()

    tap, link = (
        Mock(drain=drain, presence=list),
        Mock(expected_messages=lambda: None, by_hand=False),
    )
    writer = NotedWriter(tmp_path / "run.mcap", PLAN, SCENARIO, "launch")
    time = Mock(monotonic=lambda: clock.now_ns / 1e9, monotonic_ns=clock, sleep=clock.sleep)
    with patch("recordings.record.recorder.time", time):
        Recorder(PLAN, tap, writer, link, end, lambda text: None).run()
    # What it takes in at once, 2000 messages, is all that can come between.
    longest_s = FLUSH_S + 2000 * MESSAGE_S
    gaps_s = [later - earlier for earlier, later in pairwise([0.0, *flushed_s, LASTS_S])]
    assert max(gaps_s) <= longest_s + 1e-6
    # A nap lies between the look at the clock and the flush. More of them would cost too much.
    assert min(gaps_s[1:-1]) >= FLUSH_S - 0.01
