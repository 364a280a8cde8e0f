"""A process of a run: sets up its agents, joins the bus, and drives them through the run."""

from __future__ import annotations

import gc
import logging
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from math import inf
from typing import Any, Final

from agents.agent import Agent
from agents.cycle import kind_of
from agents.device_faults import DeviceFaults
from agents.driver import Driver
from agents.eager_driver import EagerDriver
from agents.inputs import log_drop
from agents.loop import Loop
from agents.plan import RunPlan
from agents.process.beats import BEAT_S
from agents.process.events import Failed, Finished, Joined, Waiting
from agents.process.launcher_link import LauncherLink
from agents.process.machine import own_memory_mb, take_machine
from agents.process.session import session_settings
from agents.team import controller
from bus_schemas.errors import FailureError
from bus_schemas.host_clock import HostClock
from bus_schemas.messages import GivenUp
from bus_schemas.signals import GIVEN_UP
from bus_schemas.tree import PLANT, RECORDER, ROOT
from bus_schemas.zenoh_bus import FaultyBus, ZenohBus

log = logging.getLogger(__name__)

_LOOK_S: Final = 0.02
_STOP_LOOK_S: Final = 0.5
"""How often a controller checks, after its last cycle, whether it is ended. Frequent checks of many
controllers would starve those that still join."""

_PLANT_PATIENCE_S: Final = 2.0
_CUT_PATIENCE_S: Final = 60.0
"""How long an agent on another host goes on after the plant has disappeared, in lockstep and in
real time, where a cut of the network looks the same."""

_MOST_EAGER: Final = 200
"""Messages of a cycle up to which a controller sends on Zenoh's thread. With 1,500 of them the
queue of its link to the recorder was full, and nobody there to empty it: 60 s, and the link was
closed."""

_STOP_PATIENCE_S: Final = 10.0
"""How long a controller waits after its last cycle for the plant to end the run."""

_STAY_S: Final = 3.0
_STAY_LOOK_S: Final = 0.05
"""How long an agent on another host stays on the bus after the run, and how often others check
whether all is recorded. If a session closes before the recorder has read it all, and that sends a
keep-alive, the rest is lost: 6,000 messages in a run of `thousand` on a busy machine."""


def run_controller(plan: RunPlan, name: str, link: LauncherLink, *, rejoins: bool = False) -> int:
    """Run a process of controllers; `rejoins`: into a run under way. Returns the exit status."""
    return run_guarded(name, link, lambda: _take_part(plan, name, link, rejoins))


def run_guarded(name: str, link: LauncherLink, run: Callable[[], None]) -> int:
    """Run an agent; tell the launcher if it gives up. Returns the exit status."""
    try:
        run()
    except FailureError as error:  # Its text is enough for the user.
        log.error("%s gives up: %s", name, error)
        link.tell(Failed(str(error)))
        return 1
    except Exception as error:
        log.exception("%s gives up", name)
        link.tell(Failed(f"{type(error).__name__}: {error}"))
        return 1
    return 0


def _take_part(plan: RunPlan, name: str, link: LauncherLink, rejoins: bool) -> None:
    agents = [controller(plan, member) for member in plan.wiring.members[name]]
    with AgentProcess(plan, name, agents, link) as process:
        log.info("%s is on the bus", name)
        if rejoins:
            process.await_plant()
            if plan.timing.lockstep:
                process.catch_up()
        while not link.dismissed:
            for _ in process.drive():
                if link.dismissed:
                    break
                if process.plant_is_gone() and not process.driver.finished:
                    raise FailureError("the plant is gone")
            if _is_over(process, link):
                break
        process.report()


def _is_over(process: AgentProcess, link: LauncherLink) -> bool:
    """Wait for the plant to end the run; return False if the run goes on after all.

    Any agent may say that the run ends early: the launcher confirms it, or the plant goes on.
    """
    loop, plan, driver = process.loop, process.plan, process.driver
    give_up_at = time.monotonic() + _STOP_PATIENCE_S + 2.0 * plan.timing.cycle_wall_ns / 1e9
    while driver.finished and not link.dismissed:
        if loop.times.stop_heard and loop.times.end_cycle == plan.timing.cycles:
            return True
        driver.wait_and_act(longest_ns=driver.now_ns() + round(_STOP_LOOK_S * 1e9))
        # It is through with its cycles; a process that stays in one of them counts as stuck.
        link.beat(plan.timing.cycles)
        if process.plant_is_gone():
            return True
        if time.monotonic() > give_up_at:
            log.warning("%s ends: the plant did not say that the run is over", loop.agent.name)
            return True
    return link.dismissed


class AgentProcess:
    """The agents of one process: their loops and driver on the bus, and the link to the launcher.

    It beats after each wait. A controller's own thread waits for the lock that Zenoh's thread holds
    while it acts, so an agent that hangs on either thread gives no beat.

    loop: Of its first agent, which stands for all where they are in step.
    """

    def __init__(
        self, plan: RunPlan, name: str, agents: Sequence[Agent[Any]], link: LauncherLink
    ) -> None:
        self.plan = plan
        self.link = link
        set_up_process(plan, name)
        is_away = name in plan.access.addresses
        self._bus = ZenohBus(
            name,
            plan.wiring,
            session_settings(plan, name),
            patience_s=min(plan.timing.stall_timeout_s / 2.0, BEAT_S),
            clock=HostClock(link.table.clock() if link.table else None) if is_away else None,
            sends=link.table.sends(name) if link.table and plan.timing.lockstep else None,
        )
        loops = [Loop(agent, plan, log_drop) for agent in agents]
        self.loop = loops[0]
        self.driver = make_driver(plan, loops, self._bus)
        if plan.faults.device:
            disturbed = DeviceFaults(plan.faults.device).disturbed
            self._bus.change_device_puts(partial(disturbed, cycle_time_ns=self.loop.times.time_ns))
        self.watch_tokens = self._bus.watch_tokens
        self._tokens = self.watch_tokens() if is_away or not link.table else None
        self._plant_gone_at = inf
        self._given_up = 0
        self.beat()
        link.tell(Joined())

    def __enter__(self) -> AgentProcess:
        return self

    def __exit__(self, *error: object) -> None:
        self._bus.__exit__(*error)

    def drive(self) -> Iterator[None]:
        """Drive the agents; in lockstep tell the launcher if they cannot go on."""
        driver = self.driver
        closed, waits_since = driver.closed, time.monotonic()
        for _ in driver.run():
            if driver.closed != closed:
                closed, waits_since = driver.closed, time.monotonic()
            elif (
                self.plan.timing.lockstep
                and time.monotonic() - waits_since >= self.plan.timing.stall_timeout_s
            ):
                waits_since = time.monotonic()
                self._tell_waiting()
            self.beat()
            yield

    def _tell_waiting(self) -> None:
        """Tell the launcher what the agents furthest behind need from other processes."""
        waiting = [one for one in self.driver.loops.values() if one.waiting and one.cycle >= 0]
        cycle = min((one.cycle for one in waiting), default=-1)
        own = self.driver.loops.keys()
        for loop in waiting:
            needs = [need for need in loop.needs if need[1] not in own]
            if loop.cycle == cycle and needs:
                self.link.tell(Waiting(cycle, loop.stage, needs))
                return

    def beat(self) -> None:
        """Show that the process is alive; the plant publishes which agents were given up since."""
        loop, table = self.loop, self.link.table
        self.link.beat(loop.cycle)
        if loop.name != PLANT or table is None or loop.cycle < 0:
            return
        if table.number_given_up != self._given_up:
            self._given_up = table.number_given_up
            wiring = self.plan.wiring
            agents = tuple(one for name in table.given_up() for one in wiring.members[name])
            sim_time_ns = self.plan.timing.sim_time_ns(loop.cycle)
            message = GivenUp(loop.cycle, sim_time_ns, PLANT, (), agents=agents)
            self.driver.publish(GIVEN_UP.of(ROOT), message)
            loop.give_up(agents, self.driver.now_ns())
            self.driver.advance(loop)

    def plant_is_gone(self) -> bool:
        """Whether the plant has disappeared and does not come back.

        If the launcher dies, nothing else ends an agent there, or one that was started by hand.
        """
        for key, is_there in self._tokens.changes() if self._tokens is not None else ():
            if key == self.plan.wiring.alive_key(PLANT):
                patience_s = _PLANT_PATIENCE_S if self.plan.timing.lockstep else _CUT_PATIENCE_S
                if self.loop.times.stop_heard:
                    patience_s = 0.0
                self._plant_gone_at = inf if is_there else time.monotonic() + patience_s
        return time.monotonic() > self._plant_gone_at

    def await_plant(self) -> None:
        """Join a run under way: on another host, a plant that is not seen in time has gone."""
        if self._tokens is not None:
            self._plant_gone_at = time.monotonic() + _CUT_PATIENCE_S

    def catch_up(self) -> None:
        """Join a run in lockstep, where the others wait: ask them for what they have said last."""
        wiring = self.plan.wiring
        publishers = {
            wiring.alive_key(wiring.process_of(port.publisher)) for port in self._bus.heard
        }
        tokens, loops = self.watch_tokens(), self.driver.loops
        while self.loop.cycle < 0 and not (self.link.dismissed or self.plant_is_gone()):
            if publishers <= tokens.alive():
                for member, port, message, time_ns in self._bus.newest():
                    loops[member].hear(port, message, time_ns)
            self.beat()
            time.sleep(_LOOK_S)

    def report(self) -> None:
        """Tell the launcher how it ended; stay on the bus until all is recorded."""
        self.driver.stop()
        self._bus.send_bundles()
        loops = self.driver.loops.values()
        dropped = [*self._bus.inbox.dropped.items()]
        for loop in loops:
            dropped += loop.inputs.dropped.items()
        self.link.tell(
            Finished(
                published=dict(self._bus.outbox.published),
                dropped=[(port, cause, number) for (port, cause), number in dropped],
                skipped_cycles=sum(loop.times.skipped_cycles for loop in loops),
                dismissed=self.link.dismissed and self.loop.cycle < self.plan.timing.cycles,
                own_mb=own_memory_mb(),
            )
        )
        if not self.driver.finished:  # It was dismissed in the middle of the run.
            return
        table, give_up_at = self.link.table, inf
        if self.loop.name in self.plan.access.addresses:  # The launcher is on another host.
            give_up_at = time.monotonic() + _STAY_S
        while table is not None and not table.recording_is_closed and time.monotonic() < give_up_at:
            time.sleep(_STAY_LOOK_S)


def make_driver(plan: RunPlan, loops: Sequence[Loop[Any]], bus: ZenohBus) -> Driver:
    """Return the driver of a process.

    Faults of its links delay messages, so its own thread must wait for them. The plant, and a group
    with many messages, may wait in `put`, which Zenoh's thread must not: it empties that queue.
    """
    faults = plan.network_faults()
    if any(faults.concern(loop.name) for loop in loops):
        return Driver(loops, FaultyBus(bus, faults), bus.now_ns)
    published = plan.wiring.carried[plan.wiring.process_of(loops[0].name), RECORDER]
    if loops[0].name == PLANT or len(published) > _MOST_EAGER:
        return Driver(loops, bus, bus.now_ns)
    return EagerDriver(loops, bus)


def set_up_process(plan: RunPlan, agent: str) -> None:
    """Set up this process on the machine, before it opens the bus.

    Nothing in a cycle of control makes reference cycles, so there is next to nothing to collect.
    """
    for refusal in take_machine(
        plan.supervision.machine, kind_of(agent, plan.tree), lockstep=plan.timing.lockstep
    ):
        log.warning("%s", refusal)
    gc.freeze()
    gc.set_threshold(50_000)
