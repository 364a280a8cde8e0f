"""`heliarch simulate`: the agents of a run in this one process, over memory instead of Zenoh.

They run in lockstep; where the network is to be imperfect, on a virtual clock with deadlines.
"""

from __future__ import annotations

import dataclasses
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import msgspec

from agents.agent import Agent
from agents.driver import Driver
from agents.events import Waiting
from agents.loop import AgentLoop
from agents.plan import RunPlan
from agents.team import controllers
from bus_schemas.codec import encode
from bus_schemas.memory_bus import MemoryBus, VirtualClock
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port
from bus_schemas.tree import PLANT, ROOT
from launch_scripts.launcher.interruption import interruptible
from launch_scripts.launcher.live_view import View
from launch_scripts.launcher.run_folder import RunFolder
from launch_scripts.launcher.summary import RunSummary, count_messages, memory_use, recorded_metrics
from launch_scripts.launcher.supervision import RunFailure, memory_of, who_waits
from launch_scripts.scenarios.preparation import Preparation
from recordings.record.monitor import RunMonitor
from recordings.record.writer import ClockAnchor, RunWriter
from sim_plant.plant import Plant
from sim_plant.profile import Profile

_STATUS_S = 0.25


def on_the_clock(plan: RunPlan) -> RunPlan:
    """Return the plan in real time, also if it was to be in lockstep."""
    return msgspec.structs.replace(plan, cycle_wall_ns=plan.cycle_wall_ns or plan.cycle_ns)


class MemoryRun:
    """A run in memory: in lockstep, or on a virtual clock where its network has faults.

    Parameters
    ----------
    plan, profile
        The run.
    on_publish
        Called with every message, with its port.
    """

    def __init__(
        self,
        plan: RunPlan,
        profile: Profile,
        on_publish: Callable[[Port[Message], Message], None] | None = None,
    ) -> None:
        clock = VirtualClock() if plan.faults else None
        # Within one process nobody is late: without faults a pace needs no deadlines.
        self.plan = msgspec.structs.replace(plan, cycle_wall_ns=0) if clock is None else plan
        faults = self.plan.network_faults if plan.faults else None
        self.bus = MemoryBus(self.plan.wiring, on_publish, clock, faults)
        team: list[Agent[Any]] = [Plant(self.plan, profile), *controllers(self.plan)]
        self.loops = {agent.name: AgentLoop(agent, self.plan) for agent in team}
        self._driver = Driver(self.loops.values(), self.bus, clock or time.monotonic_ns)
        self._clock = clock

    def cycles(self) -> Iterator[int]:
        """Run cycle after cycle; yield the number of each once the plant has finished it.

        Raises
        ------
        RunFailure
            The agents wait for each other.
        """
        plant = self.loops[PLANT]
        start_ns = self._driver.now_ns()
        self._publish_run(self.plan.run_message("start", 0, start_ns))
        plant.begin(start_ns, start_ns)
        done = 0
        for arrivals in self._driver.run():
            while done < plant.cycle:
                yield done
                done += 1
            if not arrivals and self._clock is None:
                waiting = {
                    name: Waiting(loop.cycle, loop.stage, loop.needs)
                    for name, loop in self.loops.items()
                    if loop.waiting
                }
                raise RunFailure(who_waits(waiting)[0])
        while done < plant.cycle:
            yield done
            done += 1

    def stop(self) -> None:
        """End the run after the cycle under way."""
        last = self.loops[PLANT].cycle + 1
        for loop in self.loops.values():
            loop.end_before(max(last, loop.cycle))

    def close(self) -> None:
        """Say that the run is over."""
        last, now_ns = self.loops[PLANT].cycle, self._driver.now_ns()
        self._publish_run(self.plan.run_message("stop", last, now_ns))

    def _publish_run(self, message: Message) -> None:
        self._driver.publish(RUN.of(ROOT), message)


def simulate(
    preparation: Preparation, folder: RunFolder, view: View, began_at: float
) -> RunSummary:
    """Run a plant in this process, recorded like a launched one.

    Raises
    ------
    RunFailure
        The agents wait for each other.
    """
    if preparation.plan.faults:
        preparation = dataclasses.replace(preparation, plan=on_the_clock(preparation.plan))
    plan = folder.fill(preparation, tcp_ports={})
    monitor = RunMonitor()
    # A virtual clock stands at 0 when the run begins.
    anchor = ClockAnchor(0, time.time_ns()) if plan.faults else ClockAnchor.now()
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
            monitor.see(port, message)

    run = MemoryRun(plan, preparation.profile, record)
    started_at = time.monotonic()
    try:
        interrupted = _follow(run, plan, monitor, writer, view)
        run.close()
    finally:
        writer.close()
    wall_s = time.monotonic() - started_at
    loops = run.loops.values()
    drops: Counter[str] = Counter()
    for loop in loops:
        for (_, cause), number in loop.dropped.items():
            drops[cause] += number
    return RunSummary(
        run_id=plan.run_id,
        scenario=plan.plant,
        driver="simulate",
        folder=str(folder.path),
        sim_start=preparation.local_start(),
        cycles=monitor.cycles,
        cycle_s=plan.cycle_ns / 1e9,
        wall_s=wall_s,
        startup_s=started_at - began_at,
        arming_rounds=0,
        metrics=recorded_metrics(folder.recording),
        messages=count_messages(run.bus.outbox.published, writer.recorded),
        dropped=dict(drops),
        missing_inputs=sum(loop.missing_inputs for loop in loops),
        faults=run.bus.tally.as_counts(),
        old_inputs=sum(loop.old_inputs for loop in loops),
        memory=memory_use({"simulation": [memory_of(os.getpid())]}),
        hindsight_neighbours=preparation.hindsight,
        remarks=preparation.remarks,
        interrupted=interrupted,
        recording_ended=writer.trouble,
    )


def _follow(
    run: MemoryRun, plan: RunPlan, monitor: RunMonitor, writer: RunWriter, view: View
) -> bool:
    """Run to the end, or to Ctrl-C. Return whether it was interrupted."""
    began_at = status_at = time.monotonic()
    # A virtual clock does not wait: with faults the pace only says how long a cycle is.
    cycle_s = 0.0 if plan.faults else plan.cycle_wall_ns / 1e9
    with interruptible() as interruption:
        for cycle in run.cycles():
            if interruption:
                run.stop()
            elif cycle_s:
                interruption.wait(began_at + (cycle + 1) * cycle_s - time.monotonic())
            if time.monotonic() >= status_at:
                status_at = time.monotonic() + _STATUS_S
                view.show(monitor.status(writer.recorded.total()))
                if cycle_s:
                    writer.flush()  # Who looks at the recording meanwhile sees the run go on.
        return bool(interruption)
