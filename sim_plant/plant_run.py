"""Begins and ends a run: the barrier before cycle 0, the start, the stop.

Messages that are put on the bus right after a session opens can get lost before all declarations
have travelled. So nothing counts until everybody's liveliness token is seen and one arming round,
a whole cycle with a number below 0, has come back to the plant and past the recorder.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Final, Literal

from agents.events import Armed
from agents.launcher_link import LauncherLink
from agents.plan import RunPlan
from agents.process import AgentProcess, run_guarded
from bus_schemas.errors import FailureError
from bus_schemas.messages import Message
from bus_schemas.signals import READY, RUN, Port
from bus_schemas.tree import PLANT, ROOT, some_of
from sim_plant.devices import Devices
from sim_plant.plant import Plant
from sim_plant.profile import Profile

log = logging.getLogger(__name__)

FIRST_ROUND: Final = -1_000_000
"""Cycle of the first arming round; the next ones count upwards."""

_FIRST_ROUND_S: Final = 0.3
_ROUND_GROWTH: Final = 1.25
_LONGEST_ROUND_S: Final = 3.0
_ROUND_PER_AGENT_S: Final = 0.005
"""How long the first arming round may take, how much longer each next one, and the longest; and how
much longer all of them for each agent."""

_ARMING_S: Final = 30.0
"""How long the arming rounds may take, once everybody is there."""

_LOOK_S: Final = 0.005
"""Time between two looks at who is there."""

_MOST_NAMED: Final = 3
"""One agent that does not answer delays all others, so only so many names are listed."""

_LEAD_S: Final = 0.2
"""In real time: how long before cycle 0 everybody is told when it begins."""


def longest_round_s(number: int) -> float:
    """Return how long an arming round, counted from 1, may take before the next one is tried [s].

    Most rounds fail because a link is not up yet, so the next one is tried soon. Later rounds have
    more time, for machines on which a whole round takes longer.
    """
    growth: float = _ROUND_GROWTH ** min(number - 1, 20)
    return min(_FIRST_ROUND_S * growth, _LONGEST_ROUND_S)


def needed_messages(waiting: Iterable[Port[Message]], external: Collection[str]) -> str:
    """Say what the plant lacks of an arming round: of external agents first, if they lack some."""
    ports = list(waiting)
    theirs = [port for port in ports if port.publisher in external]
    needs = sorted(map(str, theirs or ports)) or ["the recorder"]
    others = len(needs) - _MOST_NAMED
    rest = f" and {others} more" if others > 0 else ""
    return ", ".join(needs[:_MOST_NAMED]) + rest


def run_plant(
    plan: RunPlan, profile: Profile, link: LauncherLink, patience_s: float, folder: Path
) -> int:
    """Join the bus and lead the run in a folder. Returns the exit status.

    Everybody must appear within the patience.
    """

    def run() -> None:
        devices = Devices(plan, folder) if plan.devices else None
        with AgentProcess(plan, Plant(plan, profile, devices), link) as process:
            PlantRun(process, patience_s).run()

    return run_guarded(PLANT, link, run)


class PlantRun:
    """Takes the plant, and with it everybody, through a run."""

    def __init__(self, process: AgentProcess, patience_s: float) -> None:
        self._process = process
        self._loop = process.loop
        self._plan = process.plan
        self._patience_s = patience_s
        self._recorded_round = FIRST_ROUND - 1

    def run(self) -> None:
        """Arm, start, run, stop."""
        process, loop = self._process, self._loop
        give_up_at = time.monotonic() + self._patience_s
        self._await_everybody(give_up_at)
        # Who is there answers soon: an external agent may have been waited for much longer.
        rounds = self._arm(time.monotonic() + min(self._patience_s, _ARMING_S))
        lead_s = 0.0 if self._plan.lockstep else _LEAD_S
        start_time_ns = time.monotonic_ns() + round(lead_s * 1e9)
        self._publish_run("start", 0, start_time_ns)
        process.link.tell(Armed(rounds, start_time_ns))
        log.info("armed after %d rounds", rounds)
        loop.begin(start_time_ns, time.monotonic_ns())
        for _ in process.drive():
            if process.link.dismissed:
                loop.end_before(loop.cycle + 1)
        self._publish_run("stop", loop.cycle, start_time_ns)
        process.report()

    def _await_everybody(self, give_up_at: float) -> None:
        alive_key = self._plan.keys.alive_key
        others = {alive_key(agent): agent for agent in self._plan.processes if agent != PLANT}
        tokens = self._process.watch_tokens()
        while not others.keys() <= tokens.alive():
            if time.monotonic() > give_up_at:
                absent = [agent for key, agent in others.items() if key not in tokens.alive()]
                raise FailureError(f"no sign of life from {some_of(absent)}")
            time.sleep(_LOOK_S)

    def _arm(self, give_up_at: float) -> int:
        """Send rounds through the loop until one closes and is recorded. Return their number."""
        for number in range(1, -FIRST_ROUND):
            cycle = FIRST_ROUND + number
            self._loop.enter(cycle, time.monotonic_ns())
            self._process.driver.go_on(self._loop)
            longest_s = longest_round_s(number) + _ROUND_PER_AGENT_S * len(self._plan.tree.nodes)
            if self._round_closes(cycle, time.monotonic() + longest_s):
                return number
            if time.monotonic() > give_up_at:
                break
        needs = needed_messages(self._loop.waiting, self._plan.elsewhere)
        raise FailureError(f"no arming round closed; the plant waits for {needs}")

    def _round_closes(self, cycle: int, until: float) -> bool:
        while time.monotonic() < until:
            for arrival in self._process.driver.turn(longest_ns=round(until * 1e9)):
                if arrival.port is READY.of(ROOT):
                    self._recorded_round = arrival.message.cycle
            if not self._loop.stage and self._recorded_round == cycle:
                return True
        return False

    def _publish_run(self, state: Literal["start", "stop"], cycle: int, start_time_ns: int) -> None:
        message = self._plan.run_message(state, cycle, start_time_ns)
        self._process.driver.publish(RUN.of(ROOT), message)
