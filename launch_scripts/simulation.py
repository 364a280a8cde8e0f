"""`heliarch simulate`: the same agents as in `launch`, in one process.

They run in lockstep; where the network is to be imperfect, on a virtual clock with deadlines.
"""

from __future__ import annotations

import dataclasses
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

from agents.agent import Agent
from agents.plan import RunPlan
from agents.sequencer import Sequencer
from agents.team import controllers
from bus_schemas.codec import encode
from bus_schemas.memory_bus import MemoryBus
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port
from bus_schemas.tree import PLANT, ROOT
from launch_scripts.interruption import interruptible
from launch_scripts.live_view import View
from launch_scripts.preparation import Preparation
from launch_scripts.run_folder import RunFolder
from launch_scripts.summary import RunSummary, count_messages, memory_use, plant_metrics
from launch_scripts.supervision import RunFailure, memory_of
from launch_scripts.timed_simulation import TimedRun, on_the_clock
from recordings.lasting_writer import LastingWriter
from recordings.monitor import RunMonitor
from recordings.writer import ClockAnchor, RunWriter
from sim_plant.plant import Plant
from sim_plant.profile import Profile

_STATUS_S = 0.25


class MemoryRun:
    """A run in memory.

    Parameters
    ----------
    plan, profile
        The run.
    tap
        Called with every message, with its port.
    """

    def __init__(
        self,
        plan: RunPlan,
        profile: Profile,
        tap: Callable[[Port[Message], Message], None] | None = None,
    ) -> None:
        self.plan = plan
        self.bus = MemoryBus(plan.tree, tap)
        team: list[Agent[Any]] = [Plant(plan.tree, profile, plan.actuator), *controllers(plan)]
        self.sequencers = {
            agent.name: Sequencer(
                agent, plan.sim_time_ns, lockstep=True, horizon=plan.periods.longest
            )
            for agent in team
        }
        for sequencer in self.sequencers.values():
            sequencer.end_before(plan.cycles)

    def cycles(self) -> Iterator[int]:
        """Run cycle after cycle; yield the number of each once the plant has finished it.

        Raises
        ------
        RunFailure
            The agents wait for each other.
        """
        plant = self.sequencers[PLANT]
        self.bus.publish(RUN.of(ROOT), self.plan.run_message("start", 0, time.monotonic_ns()))
        self._send(plant.enter(0))
        done = 0
        while (delivery := self.bus.next()) is not None:
            agent, port, message = delivery
            sequencer = self.sequencers.get(agent)
            if sequencer is not None and port.signal is not RUN:
                self._send(sequencer.accept(port, message))
            while done < plant.cycle:
                yield done
                done += 1
        if not plant.finished:
            raise RunFailure(f"stalled in cycle {plant.cycle}: {self._who_waits()}")

    @property
    def published(self) -> Counter[str]:
        """Messages published so far, by signal."""
        return self.bus.published

    @property
    def faults(self) -> dict[str, int]:
        """What an imperfect network did to messages: here there is none."""
        return {}

    def stop(self) -> None:
        """End the run after the cycle under way."""
        plant = self.sequencers[PLANT]
        if plant.end_cycle == self.plan.cycles:
            plant.end_before(min(plant.cycle + 1, self.plan.cycles))

    def close(self) -> None:
        """Say that the run is over."""
        last = self.sequencers[PLANT].cycle
        self.bus.publish(RUN.of(ROOT), self.plan.run_message("stop", last, time.monotonic_ns()))

    def _send(self, outputs: list[tuple[Port[Message], Message]]) -> None:
        for port, message in outputs:
            self.bus.publish(port, message)

    def _who_waits(self) -> str:
        return "; ".join(
            f"{name} waits for {', '.join(sorted(map(str, sequencer.waiting_for)))}"
            for name, sequencer in self.sequencers.items()
            if sequencer.waiting_for
        )


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
    writer = LastingWriter(
        RunWriter(folder.recording, plan, preparation.scenario.text, "simulate", anchor),
        on_end=lambda text: view.say(f"{text}; the run goes on without it"),
    )

    def record(port: Port[Message], message: Message) -> None:
        if port.signal.logged:
            writer.add(port, message, encode(message), message.publish_time_ns)
            monitor.see(port, message)

    kind = TimedRun if plan.faults else MemoryRun
    run = kind(plan, preparation.profile, record)
    started_at = time.monotonic()
    try:
        interrupted = _follow(run, monitor, writer, view)
        run.close()
    finally:
        writer.close()
    wall_s = time.monotonic() - started_at
    drops: Counter[str] = Counter()
    for sequencer in run.sequencers.values():
        drops.update(vars(sequencer.drops))
    return RunSummary(
        run_id=plan.run_id,
        scenario=plan.plant,
        driver="simulate",
        folder=str(folder.path),
        sim_start=preparation.local_start(),
        cycles=len(monitor.plant.desired_kw),
        cycle_s=plan.cycle_ns / 1e9,
        wall_s=wall_s,
        startup_s=started_at - began_at,
        arming_rounds=0,
        metrics=plant_metrics(plan, monitor.plant),
        messages=count_messages(run.published, writer.recorded),
        dropped={cause: count for cause, count in drops.items() if count},
        missing_inputs=sum(one.missing_inputs for one in run.sequencers.values()),
        faults=run.faults,
        late_used=sum(one.late_used for one in run.sequencers.values()),
        memory=memory_use({"simulation": [memory_of(os.getpid())]}),
        hindsight_neighbours=preparation.hindsight,
        remarks=preparation.remarks,
        interrupted=interrupted,
        recording_ended=writer.trouble,
    )


def _follow(
    run: MemoryRun | TimedRun, monitor: RunMonitor, writer: LastingWriter, view: View
) -> bool:
    """Run to the end, or to Ctrl-C. Return whether it was interrupted."""
    began_at = status_at = time.monotonic()
    # On a virtual clock the pace says how long a cycle is, and nobody waits for it to pass.
    cycle_s = run.plan.cycle_wall_ns / 1e9 if isinstance(run, MemoryRun) else 0.0
    with interruptible() as interruption:
        for cycle in run.cycles():
            if interruption:
                run.stop()
            elif cycle_s:
                # A pace, but no deadlines: within one process nobody can be late.
                interruption.wait(began_at + (cycle + 1) * cycle_s - time.monotonic())
            if time.monotonic() >= status_at:
                status_at = time.monotonic() + _STATUS_S
                view.show(monitor.status(writer.recorded.total()))
        return bool(interruption)
