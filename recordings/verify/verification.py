"""Verifies a recorded run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeAlias

from agents.agent import Agent
from agents.cycle import stage_place
from agents.plan import RunPlan
from agents.team import controller
from bus_schemas.bus import Delivery
from bus_schemas.errors import InputError
from bus_schemas.signals import PRODUCTION
from bus_schemas.tree import PLANT, ROOT, agent_name
from recordings.read.gaps import recorder_absences
from recordings.read.missed_inputs import MissedInputs
from recordings.read.reader import RunReader
from recordings.read.selection import find_agents
from recordings.verify.comparison import Comparison
from recordings.verify.findings import Difference, Findings
from recordings.verify.recorded_cycles import RecordedCycles
from recordings.verify.rerun import AgentRerun
from sim_plant.plant import Plant
from sim_plant.profile import Profile, load_profile

PROFILE_NAME: Final = "profile.npz"

_Make: TypeAlias = Callable[[], Agent[Any]]


@dataclass(frozen=True, slots=True)
class Verification:
    """The result of verifying a run.

    `stop_cycle` is the first cycle that did not take place; None if the run broke off. The messages
    that were not compared are those of `RecordedCycles`. In `unrecorded_cycles` the recorder was
    away; None if it always was there. `agents` are the findings of each agent that was run again,
    `left_out` the others and why.
    """

    recording: Path
    plan: RunPlan
    stop_cycle: int | None
    cycles: int
    recorded: int
    not_decided: int
    misplaced: int
    cut_off: int
    unrecorded_cycles: int | None
    agents: dict[str, Findings]
    left_out: dict[str, str]

    def total(self, figure: str) -> int:
        """Return the sum of a figure of the findings over all agents."""
        return sum(getattr(findings, figure) for findings in self.agents.values())

    @property
    def differences(self) -> int:
        """Number of differences of all agents."""
        return sum(findings.differences.total() for findings in self.agents.values())

    @property
    def first(self) -> tuple[str, Difference] | None:
        """The agent and the difference that come first in the order of cycles and stages."""
        firsts = [(name, found.first) for name, found in self.agents.items() if found.first]
        return min(firsts, key=lambda found: self._place(*found), default=None)

    def _place(self, agent: str, difference: Difference) -> tuple[int, int]:
        stage = difference.stage
        return difference.cycle, stage_place(agent, stage, self.plan.tree) if stage else 0

    @property
    def equal(self) -> bool:
        """Whether every agent publishes what it published, as far as that was recorded."""
        return not (self.differences or self.misplaced)


def verify(
    run: Path,
    nodes: str | Sequence[str],
    comparison: Comparison,
    progress: Callable[[float], None] = lambda share: None,
    start: str | None = None,
    end: str | None = None,
) -> Verification:
    """Run agents again on the inputs of a recording and compare what they publish.

    Agents remember earlier cycles, so they always run from cycle 0 on; only the cycles from `start`
    to `end` are compared.

    By default all but external agents are run again, see `find_agents`. `progress` is called with
    the share of the recording that has been read.
    """
    with RunReader(run) as reader:
        reader.follow = progress
        plan, stop_cycle = reader.plan, reader.stop_cycle
        wanted = reader.clock.span(start, end)
        team, left_out = _team(plan, nodes, reader.path)
        missed = _missed_inputs(plan)
        recorded = RecordedCycles(_counted(reader.messages(), missed), plan, stop_cycle)
        absences = list(recorder_absences(reader))
        reruns = [
            AgentRerun(name, make, plan, recorded, absences, comparison, wanted.start)
            for name, make in team.items()
        ]
        away = {cycle for name, absence in absences if name == PLANT for cycle in absence}
        cycles = unrecorded = 0
        for cycle in recorded:
            if cycle.number >= wanted.stop:
                break
            for rerun in reruns:
                rerun.take(cycle.number)
            if cycle.number >= wanted.start:
                cycles += bool(cycle.messages)
                unrecorded += cycle.number in away and PRODUCTION.of(ROOT) not in cycle.messages
        for rerun in reruns:
            rerun.end()
            if missed is not None:
                rerun.findings.missing_inputs = missed.missing[rerun.name].total()
                rerun.findings.old_inputs = missed.old[rerun.name]
        found = Verification(
            reader.path,
            plan,
            stop_cycle,
            cycles,
            recorded.read,
            recorded.not_decided,
            recorded.misplaced,
            recorded.cut_off,
            unrecorded if absences else None,
            {rerun.name: rerun.findings for rerun in reruns},
            left_out,
        )
    if not found.total("recorded") and found.equal:
        raise InputError(f"{found.recording}: expected messages of {', '.join(team)}, got none")
    return found


def _missed_inputs(plan: RunPlan) -> MissedInputs | None:
    """Return what counts missed inputs; None if an agent cannot be made, which is a finding."""
    try:
        return MissedInputs(plan)
    except (Exception, SystemExit):
        return None


def _counted(messages: Iterable[Delivery], missed: MissedInputs | None) -> Iterator[Delivery]:
    for port, message in messages:
        if missed is not None:
            missed.count(port, message)
        yield port, message


def run_profile(plan: RunPlan, recording: Path) -> Profile | None:
    """Return the profile that lies beside a recording, None if there is none."""
    path = recording.with_name(PROFILE_NAME)
    if not path.exists():
        return None
    profile = load_profile(path)
    shape = (plan.cycles, len(plan.inverters))
    if profile.mpp_kw.shape != shape:
        raise InputError(
            f"{path}: expected {shape} cycles and inverters, as the recorded run has, "
            f"got {profile.mpp_kw.shape}"
        )
    return profile


def _team(
    plan: RunPlan, nodes: str | Sequence[str], recording: Path
) -> tuple[dict[str, _Make], dict[str, str]]:
    """Return what makes each agent, in the order of the control tree, and why others are left out.

    An external agent is run again only on request: it need not do what ours does.
    """
    team: dict[str, _Make] = {}
    left_out: dict[str, str] = {}
    wanted = find_agents(plan.tree, nodes)
    for name in (PLANT, *map(agent_name, plan.tree.nodes)):
        if wanted and name not in wanted:
            continue
        if name in plan.external and not nodes:
            left_out[name] = "it is external"
        elif name != PLANT:
            team[name] = partial(controller, plan, name)
        elif plan.devices:
            left_out[name] = "some of its inverters were devices"
        elif (profile := run_profile(plan, recording)) is not None:
            team[name] = partial(Plant, plan, profile)
        elif nodes:
            raise InputError(f"--nodes {PLANT}: expected {PROFILE_NAME} beside {recording}")
        else:
            left_out[name] = f"there is no {PROFILE_NAME} beside the recording"
    return team, left_out
