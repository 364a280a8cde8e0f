"""Begins and ends a run: the barrier before cycle 0, the start, the stop.

Messages that are put on the bus right after a session opens can get lost before all declarations
have travelled. So nothing counts until everybody's liveliness token is seen and one arming round,
a whole cycle with a number below 0, has come back to the plant and past the recorder.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Collection, Iterable
from typing import Final, Literal, TypeVar

from agents.events import Armed
from agents.garbage import spare_the_collector
from agents.runtime import Runtime
from bus_schemas.messages import Message
from bus_schemas.signals import READY, RUN, Port
from bus_schemas.tree import PLANT, RECORDER, ROOT

S = TypeVar("S")

log = logging.getLogger(__name__)

FIRST_ROUND: Final = -1_000_000
"""Cycle of the first arming round; the next ones count upwards."""

_FIRST_ROUND_S: Final = 0.3
_ROUND_GROWTH: Final = 1.25
_LONGEST_ROUND_S: Final = 3.0
"""How long the first arming round may take, how much longer each next one, and the longest."""

_ARMING_S: Final = 30.0
"""How long the arming rounds may take, once everybody is there."""

_MOST_NAMED: Final = 3
"""One agent that does not answer holds up all: more names than that say nothing more."""

_LEAD_S: Final = 0.2
"""In real time: how long before cycle 0 everybody is told when it begins."""


class ArmingError(Exception):
    """The loop did not close."""


def longest_round_s(number: int) -> float:
    """Return how long an arming round, counted from 1, may take before the next one is tried [s].

    Most that fail do so because a link is not up yet, and the next one is soon tried. On a machine
    so slow that a whole round does not fit, later ones have more time.
    """
    growth: float = _ROUND_GROWTH ** min(number - 1, 20)
    return min(_FIRST_ROUND_S * growth, _LONGEST_ROUND_S)


def needed_words(waiting_for: Iterable[Port[Message]], external: Collection[str]) -> str:
    """Say what the plant lacks of an arming round.

    External agents' words alone, where some are among them: since one agent that is silent holds
    up all, the others' follow from theirs.
    """
    ports = list(waiting_for)
    theirs = [port for port in ports if port.publisher in external]
    needs = sorted(map(str, theirs or ports)) or ["the recorder"]
    others = len(needs) - _MOST_NAMED
    rest = f" and {others} more" if others > 0 else ""
    return ", ".join(needs[:_MOST_NAMED]) + rest


class Conductor:
    """Takes the plant, and with it everybody, through a run.

    Parameters
    ----------
    runtime
        The plant's.
    stop_asked
        Set, from any thread, to end the run after the cycle under way.
    patience_s
        How long to wait for everybody before giving up.
    """

    def __init__(
        self, runtime: Runtime[S], stop_asked: threading.Event, patience_s: float = 30.0
    ) -> None:
        self._runtime = runtime
        self._stop_asked = stop_asked
        self._patience_s = patience_s
        self._round_recorded = FIRST_ROUND - 1
        runtime.listen(READY.of(ROOT), self._hear_recorder)

    def conduct(self) -> None:
        """Arm, start, run, stop.

        Raises
        ------
        ArmingError
            Somebody did not appear, or no arming round came back; the message names who.
        """
        give_up_at = time.monotonic() + self._patience_s
        self._await_everybody(give_up_at)
        # Who is there answers soon: an external agent may have been waited for much longer.
        rounds = self._arm(time.monotonic() + min(self._patience_s, _ARMING_S))
        sequencer = self._runtime.sequencer
        lead_s = 0.0 if self._runtime.plan.lockstep else _LEAD_S
        start_time_ns = time.monotonic_ns() + round(lead_s * 1e9)
        self._publish_run("start", 0, start_time_ns)
        self._runtime.lifeline.tell(Armed(rounds))
        log.info("armed after %d rounds", rounds)
        watch = self._runtime.watch_for_stalls()
        spare_the_collector(interludes=not self._runtime.plan.lockstep)
        self._runtime.begin(start_time_ns)
        while not sequencer.finished:
            if self._stop_asked.is_set() and sequencer.end_cycle == self._runtime.plan.cycles:
                sequencer.end_before(sequencer.cycle + 1)
            self._runtime.turn()
        watch.stop()
        self._publish_run("stop", sequencer.cycle, start_time_ns)
        self._runtime.report()

    def _await_everybody(self, give_up_at: float) -> None:
        others = [agent for agent in self._runtime.plan.tree.agents() if agent != PLANT]
        while True:
            alive = self._runtime.bus.agents_alive(others)
            absent = [agent for agent in others if agent not in alive]
            if not absent:
                return
            if time.monotonic() > give_up_at:
                raise ArmingError(f"no sign of life from {', '.join(absent)}")
            time.sleep(0.02)

    def _arm(self, give_up_at: float) -> int:
        """Send rounds through the loop until one closes and is recorded. Return their number."""
        sequencer = self._runtime.sequencer
        for round_number in range(1, -FIRST_ROUND):
            cycle = FIRST_ROUND + round_number
            self._runtime.send(sequencer.enter(cycle))
            if self._round_closes(cycle, time.monotonic() + longest_round_s(round_number)):
                return round_number
            if time.monotonic() > give_up_at:
                break
        needs = needed_words(sequencer.waiting_for, self._runtime.plan.external)
        raise ArmingError(f"no arming round closed; the plant waits for {needs}")

    def _round_closes(self, cycle: int, until: float) -> bool:
        sequencer = self._runtime.sequencer
        while time.monotonic() < until:
            if not sequencer.stage and self._round_recorded == cycle:
                return True
            self._runtime.turn(longest_s=0.02)
        return False

    def _hear_recorder(self, message: Message) -> None:
        if message.source == RECORDER:
            self._round_recorded = message.cycle

    def _publish_run(self, state: Literal["start", "stop"], cycle: int, start_time_ns: int) -> None:
        message = self._runtime.plan.run_message(state, cycle, start_time_ns)
        self._runtime.bus.publish(RUN.of(ROOT), message)
