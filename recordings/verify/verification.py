"""Verifies a recorded run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

from agents.agent import Agent
from agents.cycle import stage_place
from agents.direct import DirectController
from agents.plan import RunPlan
from agents.team import controller, direct_controller
from bus_schemas.code_digest import code_digest
from bus_schemas.errors import InputError
from bus_schemas.selection import find_agents
from bus_schemas.tree import PLANT, agent_name
from recordings.read.gaps import unrecorded_spans
from recordings.read.reader import RunReader
from recordings.verify.comparison import BIT_FOR_BIT, AgentResult, Difference, Equality
from recordings.verify.recorded_cycles import RecordedCycles
from recordings.verify.rerun import AgentRerun, DeviceController
from sim_plant.plant import Plant
from sim_plant.profile import PROFILE_NAME, Profile, load_profile

_Make: TypeAlias = Callable[[], Agent[Any]]


@dataclass(frozen=True, slots=True)
class Verification:
    """The result of verifying a run.

    `stop_cycle` is the first cycle that did not take place; None if the run broke off. `misplaced`
    counts messages of no cycle. `asked` counts the recorded messages of the agents that are to be
    compared. `agents` are the results of the agents that were run again, `left_out` the others and
    why. `same_code` says whether the recording was made by the code at hand; None if it does not
    say.
    """

    recording: Path
    plan: RunPlan
    stop_cycle: int | None
    cycles: int
    misplaced: int
    asked: int
    agents: dict[str, AgentResult]
    left_out: dict[str, str]
    same_code: bool | None

    def total(self, figure: str) -> int:
        """Return the sum of a figure over the results of all agents."""
        return sum(getattr(result, figure) for result in self.agents.values())

    @property
    def differences(self) -> int:
        return sum(result.differences.total() for result in self.agents.values())

    @property
    def first(self) -> tuple[str, Difference] | None:
        """The agent and the difference that come first in the order of cycles and stages."""
        firsts = [(name, result.first) for name, result in self.agents.items() if result.first]
        return min(firsts, key=lambda first: self._order(*first), default=None)

    def _order(self, agent: str, difference: Difference) -> tuple[int, int]:
        stage = difference.stage
        return difference.cycle, stage_place(agent, stage, self.plan.tree) if stage else 0

    @property
    def differs(self) -> bool:
        return bool(self.differences or self.misplaced)

    @property
    def share(self) -> float:
        """Share of the messages to be compared that were compared."""
        return self.total("compared") / max(self.asked, 1)

    @property
    def equal(self) -> bool:
        """Whether every message was compared and every agent publishes what it published."""
        return not self.differs and self.total("compared") == self.asked > 0


def verify(
    run: Path,
    nodes: str | Sequence[str] = (),
    equality: Equality = BIT_FOR_BIT,
    *,
    progress: Callable[[float], None] = lambda share: None,
) -> Verification:
    """Run agents again on the inputs of a recording and compare what they publish.

    By default all but external parents and plants are run again, see `find_agents`; a node that is
    named is run again in any case. Its result is `verify(run, node).agents[node]`.

    `progress` is called with the share of the recording that has been read.
    """
    with RunReader(run) as reader:
        reader.follow = progress
        plan, stop_cycle = reader.plan, reader.stop_cycle
        code = reader.metadata.get("run", {}).get("code")
        team, left_out = _team(plan, nodes, reader.path)
        absences = unrecorded_spans(reader)
        recorded = RecordedCycles(reader.messages(), plan, stop_cycle, list(absences))
        reruns = {
            name: AgentRerun(name, make, plan, recorded, equality) for name, make in team.items()
        }
        cycles = left_out_messages = 0
        for cycle, messages in recorded:
            for rerun in reruns.values():
                rerun.take(cycle)
            cycles += bool(messages)
            of = (len(found) for port, found in messages.items() if port.publisher in left_out)
            left_out_messages += sum(of)
    results = {name: rerun.result for name, rerun in reruns.items()}
    verification = Verification(
        reader.path,
        plan,
        stop_cycle,
        cycles,
        recorded.misplaced,
        left_out_messages + sum(result.recorded for result in results.values()),
        results,
        left_out,
        code == code_digest() if code else None,
    )
    if not verification.total("recorded") and not verification.differences:
        raise InputError(f"{reader.path}: expected messages of {', '.join(team)}, got none")
    return verification


def run_profile(plan: RunPlan, recording: Path) -> Profile | None:
    path = recording.with_name(PROFILE_NAME)
    if not path.exists():
        return None
    shape = (plan.timing.cycles, len(plan.inverters))
    profile = load_profile(path, *shape)
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

    An external parent or plant is run again only on request: it need not do what ours does.
    """
    team: dict[str, _Make] = {}
    left_out: dict[str, str] = {}
    wanted = find_agents(plan.tree, nodes)
    for name in (PLANT, *map(agent_name, plan.tree.nodes)):
        if wanted and name not in wanted:
            continue
        is_direct = name in plan.tree.leaves
        is_free = name in plan.access.external and (plan.faults.device or not is_direct)
        if is_free and not nodes:
            left_out[name] = "it is external"
        elif is_direct:
            own_estimate = name in plan.access.external and plan.control.scheme != "paper"
            kind = DeviceController if own_estimate else DirectController
            team[name] = partial(direct_controller, plan, name, kind)
        elif name != PLANT:
            team[name] = partial(controller, plan, name)
        elif plan.site.devices:
            left_out[name] = "some of its inverters were devices"
        elif (profile := run_profile(plan, recording)) is not None:
            team[name] = partial(Plant, plan, profile)
        elif nodes:
            raise InputError.of(f"--nodes {PLANT}", f"expected {PROFILE_NAME} beside {recording}")
        else:
            left_out[name] = f"there is no {PROFILE_NAME} beside the recording"
    return team, left_out
