"""Small runs in memory, in lockstep and with messages that are late or lost, as recordings."""

from __future__ import annotations

import random
import time
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np

from agents.agent import Agent
from agents.deadlines import stage_place
from agents.plan import RunPlan, Scheme
from agents.sequencer import Sequencer
from agents.team import controllers
from bus_schemas.bus import Delivery, Outbox
from bus_schemas.codec import encode
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port, listeners
from bus_schemas.tree import PLANT, ROOT
from launch_scripts.simulation import MemoryRun
from launch_scripts.verification.verification import PROFILE_NAME
from recordings.writer import RECORDING_NAME, RunWriter
from sim_plant.plant import Plant
from sim_plant.profile import Profile

TWO_TIERS: Final = {"c1/a": 100.0, "c1/b": 100.0, "c2/c": 120.0, "c2/d": 60.0}
THREE_TIERS: Final = {"z1/c1/a": 100.0, "z1/c1/b": 80.0, "z1/c2/c": 100.0, "z2/c3/d": 90.0}


def plan_of(
    ratings_kw: dict[str, float] = TWO_TIERS,
    *,
    cycles: int = 12,
    period_cycles: tuple[int, ...] = (1, 1),
    cycle_wall_ns: int = 0,
    scheme: Scheme = "predictive",
) -> RunPlan:
    """Plan of a run, from the path and rating of each inverter; without deadlines by default."""
    return RunPlan(
        run_id="by-hand",
        plant="oahu",
        inverters=tuple(ratings_kw.items()),
        start_time_ns=1_270_159_200_000_000_000,
        cycle_ns=1_000_000_000,
        cycles=cycles,
        timezone="Pacific/Honolulu",
        regulation_capacity_kw=0.0,
        cycle_wall_ns=cycle_wall_ns,
        period_cycles=period_cycles,
        scheme=scheme,
        actuator="fraction",
        alpha_min=0.05,
        hold_cycles=3,
        stall_timeout_s=3.0,
        neighbourhoods=(),
        tcp_ports={},
    )


def cloudy_profile(plan: RunPlan, seed: int = 1) -> Profile:
    """Each inverter between nothing and its rating, changing fast, so that many ask for help."""
    generator = np.random.default_rng(seed)
    ratings_kw = np.array([rating_kw for _, rating_kw in plan.inverters])
    mpp_kw = ratings_kw * generator.uniform(0.0, 1.0, (plan.cycles, len(ratings_kw)))
    # Now and then more than the plant's rating is dispatched: the central controller gives notice.
    dispatch_kw = ratings_kw.sum() * generator.uniform(0.2, 1.1, plan.cycles)
    return Profile(mpp_kw, dispatch_kw)


def lockstep_run(plan: RunPlan, profile: Profile) -> list[Delivery]:
    """All that is said in a run in lockstep, in the order of a recorder."""
    said: list[Delivery] = []
    run = MemoryRun(plan, profile, lambda port, message: said.append((port, message)))
    for _ in run.cycles():
        pass
    run.close()
    return said


def record(
    folder: Path, plan: RunPlan, said: Iterable[Delivery], profile: Profile | None = None
) -> Path:
    """Write a recording into a folder, which is made if need be. Return the folder."""
    folder.mkdir(exist_ok=True)
    (folder / RECORDING_NAME).unlink(missing_ok=True)
    driver = "simulate" if plan.lockstep else "launch"
    writer = RunWriter(folder / RECORDING_NAME, plan, 'name = "oahu"\n', driver)
    for port, message in said:
        writer.add(port, message, encode(message), time.monotonic_ns())
    writer.close()
    if profile is not None:
        profile.save(folder / PROFILE_NAME)
    return folder


class TroubledRun:
    """A run in real time, without a clock: stages close in the order of their deadlines.

    A message may be lost on its way to a listener, come some cycles late, or twice; the recorder
    hears all of them once. One agent may stand still for some cycles, and then catch up.

    Parameters
    ----------
    plan, profile
        The run.
    seed
        Of the trouble.
    lost, late, doubled
        Share of the messages.
    latest
        How many cycles a late one may come late.
    frozen
        Agent that stands still, and in which cycles.
    """

    def __init__(
        self,
        plan: RunPlan,
        profile: Profile,
        seed: int,
        *,
        lost: float = 0.03,
        late: float = 0.03,
        doubled: float = 0.0,
        latest: int = 1,
        frozen: tuple[str, range] = ("", range(0)),
    ) -> None:
        self.said: list[Delivery] = []
        self.plan = plan
        self.profile = profile
        self._random = random.Random(seed)
        self._lost, self._late, self._doubled = lost, late, doubled
        self._latest = latest
        self._frozen = frozen
        self._now = 0
        self._outbox = Outbox()
        self._queue: deque[tuple[str, Port[Message], Message]] = deque()
        self._later: dict[int, list[tuple[str, Port[Message], Message]]] = {}
        team: list[Agent[object]] = [
            Plant(plan.tree, profile, plan.actuator),  # type: ignore[list-item]
            *controllers(plan),
        ]
        self.sequencers: dict[str, Sequencer[object]] = {}
        for agent in team:
            sequencer = Sequencer(
                agent,
                plan.sim_time_ns,
                lockstep=False,
                horizon=plan.periods.longest,
                late=plan.late,
            )
            sequencer.end_before(plan.cycles)
            self.sequencers[agent.name] = sequencer

    @property
    def missing_inputs(self) -> int:
        """Inputs that the agents had to do without."""
        return sum(sequencer.missing_inputs for sequencer in self.sequencers.values())

    @property
    def late_used(self) -> int:
        """Late words that the agents used."""
        return sum(sequencer.late_used for sequencer in self.sequencers.values())

    @property
    def skipped_cycles(self) -> int:
        """Cycles that an agent gave up after it had stood still."""
        return sum(sequencer.skipped_cycles for sequencer in self.sequencers.values())

    def run(self) -> list[Delivery]:
        """Run all cycles; return what the recorder heard."""
        self._publish([(RUN.of(ROOT), self.plan.run_message("start", 0, 1))])
        for sequencer in self.sequencers.values():
            self._publish(sequencer.enter(0))
        for cycle in range(self.plan.cycles + 1):
            self._run_until(cycle)
        self._publish([(RUN.of(ROOT), self.plan.run_message("stop", self.plan.cycles, 1))])
        return self.said

    def _run_until(self, cycle: int) -> None:
        """Let the agents that move come to the end of a cycle: the last one lets all end."""
        self._now = cycle
        self._queue.extend(self._later.pop(cycle, ()))
        for agent, sequencer in self.sequencers.items():
            if cycle - sequencer.cycle >= 2 and self._moves(agent, cycle):
                self._publish(sequencer.catch_up(cycle))
        while True:
            self._deliver(cycle)
            open_agents = [
                agent
                for agent, sequencer in self.sequencers.items()
                if sequencer.cycle <= cycle and sequencer.stage and self._moves(agent, cycle)
            ]
            if not open_agents:
                return
            due = min(open_agents, key=self._deadline)
            self._publish(self.sequencers[due].close_stage())

    def _deadline(self, agent: str) -> tuple[int, int]:
        sequencer = self.sequencers[agent]
        return sequencer.cycle, stage_place(agent, sequencer.stage, self.plan.tree)

    def _moves(self, agent: str, cycle: int) -> bool:
        frozen, when = self._frozen
        return agent != frozen or cycle not in when

    def _deliver(self, cycle: int) -> None:
        held = []
        while self._queue:
            agent, port, message = self._queue.popleft()
            if self._moves(agent, cycle):
                self._publish(self.sequencers[agent].accept(port, message))
            else:
                held.append((agent, port, message))
        self._queue.extend(held)

    def _publish(self, outputs: list[Delivery]) -> None:
        for port, message in outputs:
            stamped = self._outbox.stamp(port, message)
            self.said.append((port, stamped))
            if port.signal is RUN:
                continue
            for agent in listeners(port, self.plan.tree):
                fate = self._random.random()
                copies = 1 + (self._random.random() < self._doubled)
                if fate < self._late:
                    self._send_later([(agent, port, stamped)] * copies)
                elif fate > self._lost + self._late:
                    self._queue.append((agent, port, stamped))
                    self._send_later([(agent, port, stamped)] * (copies - 1))

    def _send_later(self, deliveries: list[tuple[str, Port[Message], Message]]) -> None:
        for delivery in deliveries:
            cycle = self._now + self._random.randint(1, self._latest)
            self._later.setdefault(cycle, []).append(delivery)


def of_publisher(said: Iterable[Delivery], agent: str) -> list[Delivery]:
    """What one agent said, the plant's word on the run left out."""
    return [pair for pair in said if pair[0].publisher == agent and pair[0].signal is not RUN]


AGENTS: Final = (PLANT, "central", "c1", "c2", *TWO_TIERS)
"""All agents of a run of two tiers that are re-run."""
