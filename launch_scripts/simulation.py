"""`heliarch simulate`: the agents of a run in this one process, over memory instead of Zenoh.

They run in lockstep; where the network is to be imperfect, on a virtual clock with deadlines.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from heapq import heappop, heappush
from itertools import count
from resource import RUSAGE_SELF, getrusage
from typing import Any, Final

from msgspec.structs import replace

from agents.agent import Agent
from agents.driver import Driver
from agents.faults import Incident, incidents
from agents.loop import Loop
from agents.plan import RunPlan, changed
from agents.process.events import Recorded, Waiting
from agents.process.interruption import interruptible
from agents.process.machine import own_memory_mb
from agents.team import controller
from bus_schemas.bus import Arrival
from bus_schemas.codec import encode
from bus_schemas.errors import FailureError
from bus_schemas.memory_bus import MemoryBus, VirtualClock
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port
from bus_schemas.tree import PLANT, ROOT, agent_name
from launch_scripts.run_end import begun, ended
from launch_scripts.run_folder import RunFolder
from launch_scripts.stall import who_waits
from launch_scripts.view import View
from recordings.record.phases import RunProgress
from recordings.record.writer import ClockAnchor, RunWriter
from results.run_document import ProcessAccount, RunDocument
from scenarios.preparation import Preparation
from sim_plant.plant import Plant
from sim_plant.profile import Profile

_STATUS_S: Final = 0.25

RESTART_TAKES_S: Final = 0.5
"""Time from the death of a controller until its successor hears messages: as measured on real
processes, see docs/resilience.md."""


def on_the_clock(plan: RunPlan) -> RunPlan:
    """Return the plan in real time, also if it was to be in lockstep."""
    return changed(
        plan, timing={"cycle_wall_ns": plan.timing.cycle_wall_ns or plan.timing.cycle_ns}
    )


class MemoryRun:
    """A run in memory: in lockstep, or on a virtual clock where its network has faults.

    `on_publish` is called with every message, with its port; `make_plant` makes the plant.
    """

    def __init__(
        self,
        plan: RunPlan,
        profile: Profile,
        on_publish: Callable[[Port[Message], Message], None] | None = None,
        make_plant: Callable[[RunPlan, Profile], Plant] = Plant,
    ) -> None:
        clock = VirtualClock() if plan.faults.rules else None
        # Within one process no message is late: without faults a pace needs no deadlines.
        self.plan = changed(plan, timing={"cycle_wall_ns": 0}) if clock is None else plan
        faults = self.plan.network_faults() if plan.faults.rules else None
        self._frozen: dict[str, tuple[Loop[Any], int]] = {}
        self._restarted_s: dict[str, list[float]] = {}
        self.given_up: dict[str, int] = {}
        self.bus = MemoryBus(self.plan.wiring.listeners, on_publish, clock, faults)
        team: list[Agent[Any]] = [make_plant(self.plan, profile)]
        team += [controller(self.plan, agent_name(node)) for node in self.plan.tree.nodes]
        self.loops = {agent.name: Loop(agent, self.plan) for agent in team}
        self.driver = Driver(self.loops.values(), self.bus, clock or time.monotonic_ns)
        self._clock = clock
        self._due: list[tuple[int, int, Callable[[], object]]] = []
        self._numbers = count()
        for incident in incidents(plan.faults.rules, plan.tree, plan.wiring):
            self.at(incident.time_s, partial(self._apply, incident))

    def cycles(self) -> Iterator[int]:
        """Run all cycles; yield the number of each once the plant has finished it."""
        plant = self.loops[PLANT]
        start_ns = self.driver.now_ns()
        self._publish_run(self.plan.run_message("start", 0, start_ns))
        plant.begin(start_ns, start_ns)
        done = 0
        for arrivals in self._turns(start_ns):
            yield from range(done, plant.cycle)
            done = plant.cycle
            if not arrivals and self._clock is None:
                waiting = {
                    name: Waiting(loop.cycle, loop.stage, loop.needs)
                    for name, loop in self.loops.items()
                    if loop.waiting
                }
                raise FailureError(who_waits(waiting, self.plan)[0])
        yield from range(done, plant.cycle)

    def _turns(self, start_ns: int) -> Iterator[Sequence[Arrival]]:
        """Drive the agents, and apply the fault rules when they are due."""
        driver, due = self.driver, self._due
        for loop in list(driver.loops.values()):
            driver.advance(loop)
        while not self._is_over():
            while due and due[0][0] <= driver.now_ns():
                heappop(due)[-1]()
            yield driver.wait_and_act(longest_ns=due[0][0] if due else None)

    def _is_over(self) -> bool:
        """Whether all have finished; one that never joined is not waited for."""
        loops = self.driver.loops.values()
        return self.loops[PLANT].finished and all(one.finished or one.cycle < 0 for one in loops)

    def at(self, time_s: float, act: Callable[[], object]) -> None:
        """Do something at a simulated time since cycle 0 [s]."""
        # A cycle of the virtual clock may be longer or shorter than in simulated time.
        scale = self.plan.timing.cycle_wall_ns / self.plan.timing.cycle_ns
        heappush(self._due, (round(time_s * 1e9 * scale), next(self._numbers), act))

    def after(self, wait_s: float, act: Callable[[], object]) -> None:
        """Do something after a time of the virtual clock [s]."""
        due_ns = self.driver.now_ns() + round(wait_s * 1e9)
        heappush(self._due, (due_ns, next(self._numbers), act))

    def remove(self, name: str) -> Loop[Any]:
        """Take a controller out of the run; messages on their way to it are lost."""
        self.bus.hold(name, keep=False)
        frozen, _ = self._frozen.pop(name, (None, 0))
        return frozen or self.driver.leave(name)

    def start(self, name: str) -> None:
        """Start a new process of a controller that was taken out."""
        self.loops[name] = Loop(controller(self.plan, name), self.plan)
        self.bus.release(name)
        self.driver.join(self.loops[name])

    def _apply(self, incident: Incident) -> None:
        """Kill, freeze or thaw a controller, if it is in a state for it."""
        name = incident.agent
        match incident.what:
            case "kill" if name in self.driver.loops or name in self._frozen:
                self._kill(name)
            case "freeze" if name in self.driver.loops:
                since_ns = self.driver.now_ns()
                self._frozen[name] = (self.driver.leave(name), since_ns)
                self.bus.hold(name, keep=True)
                policy = self.plan.supervision.restart
                if policy.when != "never":
                    self.after(policy.frozen_s, partial(self._replace_frozen, name, since_ns))
            case "thaw" if name in self._frozen:
                self.bus.release(name)
                self.driver.join(self._frozen.pop(name)[0])

    def _replace_frozen(self, name: str, since_ns: int) -> None:
        if self._frozen.get(name, (None, None))[1] == since_ns:
            self._kill(name)

    def _kill(self, name: str) -> None:
        """Kill a process; the restart policy says whether and when a new one is started."""
        self.remove(name)
        earlier_s, now_s = self._restarted_s.setdefault(name, []), self.driver.now_ns() / 1e9
        wait_s = self.plan.supervision.restart.wait_s(earlier_s, now_s)
        if wait_s is None:
            self.given_up[name] = max(self.loops[PLANT].cycle, 0)
            return
        earlier_s.append(now_s)
        self.after(wait_s + RESTART_TAKES_S, partial(self.start, name))

    @property
    def restarts(self) -> dict[str, int]:
        return {name: len(times_s) for name, times_s in self._restarted_s.items() if times_s}

    def stop(self) -> None:
        last = self.loops[PLANT].cycle + 1
        for loop in self.loops.values():
            loop.end_before(max(last, loop.cycle))

    def close(self) -> None:
        last, now_ns = self.loops[PLANT].cycle, self.driver.now_ns()
        self._publish_run(self.plan.run_message("stop", last, now_ns))

    def _publish_run(self, message: Message) -> None:
        self.driver.publish(RUN.of(ROOT), message)


def run_in_one_process(
    preparation: Preparation, folder: RunFolder, view: View, began_at: float
) -> RunDocument:
    """Run a plant in this process, recorded like a launched one."""
    plan = changed(preparation.plan, site={"devices": ()})  # In memory none is real.
    preparation = dataclasses.replace(
        preparation, plan=on_the_clock(plan) if plan.faults.rules else plan
    )
    plan = folder.fill(preparation, tcp_ports={})
    progress = RunProgress(plan)
    # A virtual clock stands at 0 when the run begins.
    anchor = ClockAnchor(0, time.time_ns()) if plan.faults.rules else ClockAnchor.now()
    writer = RunWriter(
        folder.recording,
        plan,
        preparation.scenario.text,
        "simulate",
        anchor,
        on_end=lambda text: view.say(f"{text}; the run goes on without it"),
    )

    def record(port: Port[Message], message: Message) -> None:
        if port.signal.logged:
            writer.add(port, message, encode(message), message.publish_time_ns)
            progress.hear(port, message)

    run = MemoryRun(plan, preparation.profile, record)
    armed_at = time.monotonic()
    try:
        interrupted = _follow(run, plan, progress, writer, view)
        run.close()
    finally:
        writer.close()
    document = replace(
        begun(preparation, folder, "simulate"),
        wall_s=time.monotonic() - armed_at,
        startup_s=armed_at - began_at,
        interrupted=interrupted,
        restarts=run.restarts,
        given_up=run.given_up,
        processes=(
            ProcessAccount(
                "simulation",
                "simulation",
                {},
                getrusage(RUSAGE_SELF).ru_maxrss * 1.024e-3,
                own_memory_mb(),
            ),
        ),
    )
    dropped = [
        (*of, number) for loop in run.loops.values() for of, number in loop.inputs.dropped.items()
    ]
    recorded = Recorded(dict(writer.recorded), 0, progress.completed, writer.ended_early)
    return ended(document, preparation, recorded, run.bus.outbox.published, dropped)


def _follow(
    run: MemoryRun, plan: RunPlan, progress: RunProgress, writer: RunWriter, view: View
) -> bool:
    """Run to the end, or to Ctrl-C. Return whether it was interrupted."""
    began_at = status_at = time.monotonic()
    # A virtual clock does not wait: with faults the pace only says how long a cycle is.
    cycle_s = 0.0 if plan.faults.rules else plan.timing.cycle_wall_ns / 1e9
    with interruptible() as interruption:
        for cycle in run.cycles():
            if interruption:
                run.stop()
            elif cycle_s:
                interruption.wait(began_at + (cycle + 1) * cycle_s - time.monotonic())
            if time.monotonic() >= status_at:
                status_at = time.monotonic() + _STATUS_S
                view.show(progress.status(writer.recorded.total()))
                if cycle_s:
                    writer.flush()  # So that the recording can be read meanwhile.
        return bool(interruption)
