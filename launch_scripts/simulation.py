"""`heliarch simulate`: the agents of a run in this one process, over memory instead of Zenoh.

They run in lockstep; where the network is to be imperfect, on a virtual clock with deadlines.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from heapq import heapify, heappop, heappush
from resource import RUSAGE_SELF, getrusage
from typing import Any, Final

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
from bus_schemas.signals import RUN, TAKEOVER, Port
from bus_schemas.tree import PLANT, ROOT, agent_name, agent_of, standby_of
from launch_scripts.account import RunAccount
from launch_scripts.run_folder import RunFolder
from launch_scripts.supervision import who_waits
from launch_scripts.view import View
from recordings.record.phases import RunProgress
from recordings.record.writer import ClockAnchor, RunWriter
from results.run_summary import ProcessAccount, RunSummary
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
        self._incidents = incidents(plan.faults.rules, plan.tree, plan.wiring)
        self._frozen: dict[str, tuple[Loop[Any], int]] = {}
        self._restarted_s: dict[str, list[float]] = {}
        self.given_up: dict[str, int] = {}
        self.bus = MemoryBus(self.plan.wiring.hearers, on_publish, clock, faults)
        team: list[Agent[Any]] = [make_plant(self.plan, profile)]
        team += [controller(self.plan, agent_name(node)) for node in self.plan.tree.nodes]
        loops = [
            *(Loop(agent, self.plan) for agent in team),
            *(self._loop(standby_of(agent)) for agent in self.plan.standbys),
        ]
        self.loops = {loop.name: loop for loop in loops}
        self._driver = Driver(self.loops.values(), self.bus, clock or time.monotonic_ns)
        self._clock = clock

    def cycles(self) -> Iterator[int]:
        """Run cycle after cycle; yield the number of each once the plant has finished it."""
        plant = self.loops[PLANT]
        start_ns = self._driver.now_ns()
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
        driver, plan = self._driver, self.plan
        for loop in list(driver.loops.values()):
            driver.advance(loop)
        # A cycle of the virtual clock may be longer or shorter than in simulated time.
        scale = plan.timing.cycle_wall_ns / plan.timing.cycle_ns
        due = [(start_ns + round(one.time_s * 1e9 * scale), one) for one in self._incidents]
        heapify(due)
        while not self._is_over():
            while due and due[0][0] <= driver.now_ns():
                time_ns, incident = heappop(due)
                for after_s, other in self._apply(incident):
                    heappush(due, (time_ns + round(after_s * 1e9), other))
            yield driver.turn(longest_ns=due[0][0] if due else None)

    def _is_over(self) -> bool:
        """Whether all have finished; one that never joined is not waited for."""
        loops = self._driver.loops.values()
        return self.loops[PLANT].finished and all(one.finished or one.cycle < 0 for one in loops)

    def _apply(self, incident: Incident) -> Iterator[tuple[float, Incident]]:
        """Kill, freeze, thaw or start a controller; yield what follows from it, after how long."""
        driver, policy = self._driver, self.plan.supervision.restart
        name = self._process_of(incident)
        incident = incident._replace(agent=name)
        match incident.what:
            case "freeze" if name in driver.loops:
                self._frozen[name] = (driver.leave(name), driver.now_ns())
                self.bus.hold(name, keep=True)
                if policy.when != "never":
                    yield policy.frozen_s, incident._replace(what="watch")
            case "thaw" if name in self._frozen:
                if name in self.loops:
                    self.bus.release(name)
                driver.join(self._frozen.pop(name)[0])
            case "watch" if name in self._frozen:
                _, since_ns = self._frozen[name]
                if driver.now_ns() - since_ns >= round(policy.frozen_s * 1e9):
                    yield from self._kill(incident)
            case "kill" if name in driver.loops or name in self._frozen:
                yield from self._kill(incident)
            case "replace" if name in driver.loops:
                # It no longer has its name, so that nothing on the bus is for it.
                old = driver.leave(name)
                old.name = f"{name} {incident.time_s}"
                self._frozen[old.name] = (old, driver.now_ns())
                yield incident.until_s - incident.time_s, Incident(0.0, old.name, "thaw")
                yield from self._kill(incident._replace(until_s=0.0))
            case "start":
                self.loops[name] = self._loop(name)
                self.bus.release(name)
                driver.join(self.loops[name])

    def _kill(self, incident: Incident) -> Iterator[tuple[float, Incident]]:
        """Kill a process; yield its return, which the restart policy may refuse."""
        name = incident.agent
        if name in self._driver.loops:
            self._driver.leave(name)
        self._frozen.pop(name, None)
        self.bus.hold(name, keep=False)
        if incident.until_s:
            yield incident.until_s - incident.time_s, incident._replace(what="start")
            return
        earlier_s, now_s = self._restarted_s.setdefault(name, []), self._driver.now_ns() / 1e9
        wait_s = self.plan.supervision.restart.wait_s(earlier_s, now_s)
        if wait_s is None:
            self.given_up[name] = max(self.loops[PLANT].cycle, 0)
            return
        earlier_s.append(now_s)
        yield wait_s + RESTART_TAKES_S, incident._replace(what="start")

    def _loop(self, name: str) -> Loop[Any]:
        return Loop(controller(self.plan, agent_of(name)), self.plan, process=name)

    def _process_of(self, incident: Incident) -> str:
        """Return the process that a rule means: of an agent with a standby, the one that speaks."""
        name, what = incident.agent, incident.what
        if name not in self.plan.standbys or what in {"watch", "start"}:
            return name
        both = (name, standby_of(name))
        if what == "thaw":
            return next((one for one in both if one in self._frozen), name)
        there = [one for one in both if one in self._driver.loops]
        loops = self.loops  # One that has not joined yet does not speak either.
        key = [(loops[one].standby.silent or loops[one].cycle < 0, one) for one in there]
        return min(key, default=(False, name))[1]

    @property
    def restarts(self) -> dict[str, int]:
        return {name: len(times_s) for name, times_s in self._restarted_s.items() if times_s}

    def stop(self) -> None:
        last = self.loops[PLANT].cycle + 1
        for loop in self.loops.values():
            loop.end_before(max(last, loop.cycle))

    def close(self) -> None:
        last, now_ns = self.loops[PLANT].cycle, self._driver.now_ns()
        self._publish_run(self.plan.run_message("stop", last, now_ns))

    def _publish_run(self, message: Message) -> None:
        self._driver.publish(RUN.of(ROOT), message)


def simulate(
    preparation: Preparation, folder: RunFolder, view: View, began_at: float
) -> RunSummary:
    """Run a plant in this process, recorded like a launched one."""
    plan = changed(preparation.plan, site={"devices": ()})  # In memory none is real.
    preparation = dataclasses.replace(
        preparation, plan=on_the_clock(plan) if plan.faults.rules else plan
    )
    plan = folder.fill(preparation, tcp_ports={})
    account = RunAccount(preparation, folder, "simulate", began_at)
    if plan.supervision.standby and not plan.faults.rules:
        view.say("no standby: without a --fault nothing has a deadline here")
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
        if port.signal is TAKEOVER:
            account.takeovers[port.publisher] += 1
        if port.signal.logged:
            writer.add(port, message, encode(message), message.publish_time_ns)
            progress.hear(port, message)

    run = MemoryRun(plan, preparation.profile, record)
    account.armed_at = time.monotonic()
    try:
        interrupted = _follow(run, plan, progress, writer, view)
        run.close()
    finally:
        writer.close()
    wall_s = time.monotonic() - account.armed_at
    account.published.update(run.bus.outbox.published)
    account.restarts.update(run.restarts)
    account.given_up = run.given_up
    memory_mb = getrusage(RUSAGE_SELF).ru_maxrss * 1.024e-3, own_memory_mb()
    account.processes.append(ProcessAccount("simulation", "simulation", {}, *memory_mb))
    for loop in run.loops.values():
        account.dropped += [(*of, number) for of, number in loop.inputs.dropped.items()]
    recorded = Recorded(dict(writer.recorded), 0, progress.completed, writer.ended_early)
    return account.summary(recorded, wall_s, interrupted=interrupted)


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
