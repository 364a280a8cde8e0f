"""When the recorder hands on what it has heard, and whom it calls unresponsive."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle, pairwise
from pathlib import Path
from typing import cast

import pytest
from buses_by_hand import LinkByHand, SubscriberByHand
from clock_by_hand import ClockByHand
from recordings_by_hand import PLAN, SCENARIO, whole_run

from agents.plan import RunPlan
from agents.process.events import Event
from agents.process.launcher_link import LauncherLink
from bus_schemas.codec import encode
from bus_schemas.zenoh_session import RunSubscriber
from recordings.record.recorder import FLUSH_S, Recorder
from recordings.record.writer import RunWriter

MESSAGE_S = 20e-6
"""What it takes to write a message down."""

LASTS_S = 1.8


def record(
    clock: ClockByHand,
    subscriber: SubscriberByHand,
    writer: RunWriter,
    link: LinkByHand,
    plan: RunPlan = PLAN,
) -> list[Event]:
    """Record what comes, at the time of a clock by hand. Returns what the launcher is told."""
    of_run = cast("RunSubscriber", subscriber), writer, cast("LauncherLink", link)
    Recorder(plan, *of_run, now_ns=clock, sleep=clock.sleep).run()
    return link.told


@pytest.mark.parametrize("bursts_s", [0.0, 0.1])
def test_a_recording_is_flushed_every_half_second(bursts_s: float, tmp_path: Path) -> None:
    clock, link = ClockByHand(), LinkByHand()
    began_ns = clock.now_ns
    ends_ns, bursts_ns = began_ns + round(LASTS_S * 1e9), round(bursts_s * 1e9)
    said = cycle((PLAN.wiring.key(port), encode(message)) for port, message in whole_run(5))

    def drain() -> Iterator[tuple[str, bytes]]:
        """There is always one more message, or bursts of them, until the recording is to end."""
        while clock.now_ns < ends_ns:
            if bursts_ns and clock.now_ns // bursts_ns % 2:
                return
            clock.sleep(MESSAGE_S)
            yield next(said)
        link.dismissed = True

    flushed_s: list[float] = []

    class NotedWriter(RunWriter):
        def flush(self) -> None:
            flushed_s.append((clock.now_ns - began_ns) / 1e9)
            super().flush()

    writer = NotedWriter(tmp_path / "run.mcap", PLAN, SCENARIO, "launch")
    record(clock, SubscriberByHand(drain), writer, link)
    # What it takes in at once, 2000 messages, is all that can come between.
    longest_s = FLUSH_S + 2000 * MESSAGE_S
    gaps_s = [later - earlier for earlier, later in pairwise([0.0, *flushed_s, LASTS_S])]
    assert max(gaps_s) <= longest_s + 1e-6
    # A nap lies between the look at the clock and the flush. More of them would cost too much.
    assert min(gaps_s[1:-1]) >= FLUSH_S - 0.01
