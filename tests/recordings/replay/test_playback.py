"""A replay sends what is due in its order."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

import numpy as np
import pytest
from clock_by_hand import ClockByHand
from replayed_runs import CYCLE_NS, PLAN, run_in_memory, write

from agents.plan import changed
from agents.process.interruption import Interruption
from bus_schemas.codec import encode
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from heliarch.cli.live_view import StatusLine
from recordings.read.reader import RunReader
from recordings.replay.bus import ReplayBus
from recordings.replay.playback import Playback

SAID = run_in_memory()
IN_REAL_TIME = changed(PLAN, timing={"cycle_wall_ns": CYCLE_NS})


class Heard(ReplayBus):
    """What was sent, and where the replay said it stands."""

    def __init__(self, on_put: Callable[[Heard], None] = lambda heard: None) -> None:
        self.clock = ClockByHand()
        self.ports: list[Port[Message]] = []
        self.payloads: list[bytes] = []
        self.moments_ns: list[int] = []
        self.states: list[tuple[int, float]] = []
        self._on_put = on_put

    def put(self, port: Port[Message], payload: bytes) -> bool:
        self.ports.append(port)
        self.payloads.append(payload)
        self.moments_ns.append(self.clock.now_ns)
        self._on_put(self)
        return True

    def announce(self, cycle: int, *, rate: float) -> None:
        self.states.append((cycle, rate))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 40 cycles, written in batches, not as it was published."""
    places = np.arange(len(SAID))
    order = np.argsort(places + np.random.default_rng(1).uniform(0.0, 40.0, len(SAID)))
    last_ns = SAID[-1].logged_ns
    mixed = [
        SAID[place]._replace(logged_ns=last_ns + rank * 1_000) for rank, place in enumerate(order)
    ]
    assert mixed[0].port is not SAID[0].port
    return write(tmp_path_factory.mktemp("player") / "run", mixed, IN_REAL_TIME)


def play(
    recorded: Path,
    heard: Heard,
    *,
    span: range = range(41),
    rate: float = 0.0,
    waited_s: float = 0.0,
    interruption: Interruption | None = None,
    out: TextIO | None = None,
    loop: bool = False,
) -> Playback:
    """Replay the recording, as fast as possible, on the clock of who hears it."""
    with RunReader(recorded) as reader:
        ports = [port for port in PLAN.wiring.ports if port.signal.logged]
        playback = Playback(
            reader,
            ports,
            span,
            heard,
            rate,
            Interruption() if interruption is None else interruption,
            StatusLine(out or io.StringIO(), in_place=False),
            now_ns=heard.clock,
            sleep=heard.clock.sleep,
        )
        heard.clock.sleep(waited_s)
        playback.play(loop=loop)
        return playback


def payloads(first: int = 0, before: int = 1000) -> list[bytes]:
    """What was on the wire in some cycles."""
    return [encode(entry.message) for entry in SAID if first <= entry.message.cycle < before]


def test_all_bytes_are_sent_on_their_ports_in_their_order(recorded: Path) -> None:
    heard, out = Heard(), io.StringIO()
    played = play(recorded, heard, out=out)
    assert heard.payloads == payloads()
    assert heard.ports == [entry.port for entry in SAID]
    assert (played.messages, played.cycles) == (len(SAID), 40)
    assert played.latest_us is None  # as fast as possible: nothing is due
    # The message that ends the run names the cycle after the last one.
    assert heard.states == [(cycle, 0.0) for cycle in range(41)]
    assert "12:00:39 cycle 39 of 0 to 39" in out.getvalue().splitlines()[-1]


def test_a_loop_begins_again_until_the_user_ends_it(recorded: Path) -> None:
    interruption = Interruption()
    once = payloads(5, 9)

    def end_in_the_third_round(heard: Heard) -> None:
        interruption.count = int(len(heard.payloads) == 2 * len(once) + 3)

    heard = Heard(end_in_the_third_round)
    play(recorded, heard, span=range(5, 9), interruption=interruption, loop=True)
    assert heard.payloads == once + once + once[:3]


def test_each_message_is_sent_when_it_is_due_and_all_is_timed(recorded: Path) -> None:
    heard = Heard()
    played = play(recorded, heard, span=range(5, 9), rate=0.25, waited_s=60.0)
    said_ns = [entry.message.publish_time_ns for entry in SAID if 5 <= entry.message.cycle < 9]
    began_ns = heard.moments_ns[0]
    assert heard.moments_ns == [began_ns + 4 * (time_ns - said_ns[0]) for time_ns in said_ns]
    assert played.latest_us == 0.0
