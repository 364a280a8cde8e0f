"""How often the recorder hands on what it has heard: a crash loses the rest."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle, pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from clock_by_hand import ClockByHand
from recordings_by_hand import PLAN, SCENARIO, whole_run

from agents.events import Event
from agents.launcher_link import LauncherLink
from bus_schemas.codec import encode
from bus_schemas.zenoh_bus import ZenohTap
from recordings.record import recorder
from recordings.record.recorder import FLUSH_S, Recorder, RecordingEnd
from recordings.record.writer import RunWriter

MESSAGE_S = 20e-6
"""What it takes to write a message down."""

LASTS_S = 10.0


class BusyTap:
    """A bus on which there is always one more message, until the recording is to end."""

    def __init__(self, clock: ClockByHand, end: RecordingEnd, bursts_s: float) -> None:
        self._clock = clock
        self._end = end
        self._ends_ns = clock.now_ns + round(LASTS_S * 1e9)
        self._bursts_ns = round(bursts_s * 1e9)
        said = [(PLAN.keys.key(port), encode(message)) for port, message in whole_run(5)]
        self._said = cycle(said)

    def drain(self) -> Iterator[tuple[str, bytes]]:
        while self._clock.now_ns < self._ends_ns:
            if self._bursts_ns and self._clock.now_ns // self._bursts_ns % 2:
                return
            self._clock.sleep(MESSAGE_S)
            yield next(self._said)
        self._end.ask()

    def presence(self) -> list[tuple[str, bool]]:
        return []


class SilentLink:
    def tell(self, event: Event) -> None: ...

    def expected_messages(self) -> None: ...


@pytest.mark.parametrize("bursts_s", [0.0, 0.1])
def test_it_flushes_every_half_second(
    bursts_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = ClockByHand()
    began_ns = clock.now_ns
    monkeypatch.setattr(
        recorder,
        "time",
        SimpleNamespace(
            monotonic=lambda: clock.now_ns / 1e9, monotonic_ns=clock, sleep=clock.sleep
        ),
    )
    flushed_s: list[float] = []

    class NotedWriter(RunWriter):
        def flush(self) -> None:
            flushed_s.append((clock.now_ns - began_ns) / 1e9)
            super().flush()

    end = RecordingEnd()
    Recorder(
        PLAN,
        cast("ZenohTap", BusyTap(clock, end, bursts_s)),
        NotedWriter(tmp_path / "run.mcap", PLAN, SCENARIO, "launch"),
        cast("LauncherLink", SilentLink()),
        end,
        lambda text: None,
    ).run()
    # What it takes in at once, 2000 messages, is all that can come between.
    longest_s = FLUSH_S + 2000 * MESSAGE_S
    gaps_s = [later - earlier for earlier, later in pairwise([0.0, *flushed_s, LASTS_S])]
    assert max(gaps_s) <= longest_s + 1e-6
    # A nap lies between the look at the clock and the flush. More of them would cost too much.
    assert min(gaps_s[1:-1]) >= FLUSH_S - 0.01
