"""Verifies a recorded run: which agents, on which recording, with what result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeAlias

from agents.agent import Agent
from agents.cycle import stage_place
from agents.plan import RunPlan
from agents.team import controller
from bus_schemas.errors import InputError
from bus_schemas.tree import PLANT, agent_name
from recordings.read.reader import RunReader
from recordings.read.selection import find_agents
from recordings.verify.account import Account, Difference
from recordings.verify.comparison import Comparison
from recordings.verify.recorded_cycles import MOST_HELD, CycleWalk
from recordings.verify.recording_bus import RecentMessages
from recordings.verify.rerun import AgentRerun, on_a_clock
from sim_plant.plant import Plant
from sim_plant.profile import Profile, load_profile

PROFILE_NAME: Final = "profile.npz"


_CUT_OFF_CYCLES: Final = 3
"""In the last cycles of a run that broke off messages are missing, and that is no finding."""

_Make: TypeAlias = Callable[[], Agent[Any]]


@dataclass(frozen=True, slots=True)
class Verification:
    """What the verification of a run came to.

    Attributes
    ----------
    recording
        The file.
    plan
        Of the run.
    whole
        Whether the file was closed in order.
    stop_cycle
        The first cycle that did not take place, by the plant's message; None if the run broke off.
    last_cycle
        The last cycle of which the recording holds anything.
    cycles
        Cycles of which the recording holds anything.
    recorded
        Messages in the recording, of all agents.
    not_decided
        Those of them that no agent decides: the beginning and end of the run. They are not
        compared.
    strays
        Messages that belong to no cycle of the run.
    too_late
        Messages of agents that were re-run that lie so far behind their cycle that it was not kept
        for them: not compared.
    accounts
        Of each agent that was re-run.
    left_out
        Agents that were not re-run and why, by name.
    """

    recording: Path
    plan: RunPlan
    whole: bool
    stop_cycle: int | None
    last_cycle: int
    cycles: int
    recorded: int
    not_decided: int
    strays: int
    too_late: int
    accounts: dict[str, Account]
    left_out: dict[str, str]

    @property
    def compared(self) -> int:
        """Pairs of messages that were compared."""
        return sum(account.compared for account in self.accounts.values())

    @property
    def differences(self) -> int:
        """Number of differences, of all agents."""
        return sum(account.counts.total() for account in self.accounts.values())

    @property
    def not_compared(self) -> int:
        """Messages that could not be compared, since others are lost or their agent failed."""
        left_out = sum(account.not_compared for account in self.accounts.values())
        return left_out + self.too_late

    @property
    def undecided(self) -> bool:
        """Whether messages could not be compared other than where a run broke off."""
        if self.stop_cycle is not None or self.too_late:
            return self.not_compared > 0
        froms = [account.not_compared_from for account in self.accounts.values()]
        cut_off_from = self.last_cycle - _CUT_OFF_CYCLES
        return any(cycle is not None and cycle <= cut_off_from for cycle in froms)

    @property
    def first(self) -> tuple[str, Difference] | None:
        """The difference that came first in the order of cycles and stages, and whose it is."""
        firsts = [
            (name, account.first)
            for name, account in self.accounts.items()
            if account.first is not None
        ]
        return min(firsts, key=lambda found: self._moment(*found), default=None)

    def _moment(self, agent: str, difference: Difference) -> tuple[int, int]:
        tree = self.plan.tree
        stage = difference.stage
        return difference.cycle, stage_place(agent, stage, tree) if stage else 0

    @property
    def missing_inputs(self) -> int:
        """Inputs that the agents had to do without when the run was recorded."""
        return sum(account.missing_inputs for account in self.accounts.values())

    @property
    def old_inputs(self) -> int:
        """Older inputs that the agents used in place of those that were due."""
        return sum(account.old_inputs for account in self.accounts.values())

    @property
    def equal(self) -> bool:
        """Whether every agent publishes what it published, as far as the recording can tell."""
        return not self.differences and not self.strays and not self.undecided


def verify(
    run: Path,
    nodes: Sequence[str],
    comparison: Comparison,
    progress: Callable[[int, int], None] = lambda cycle, cycles: None,
) -> Verification:
    """Re-run agents on the inputs of a recording and compare what they publish.

    Parameters
    ----------
    run
        Folder of the run, or its MCAP file.
    nodes
        Agents to re-run, see `select_agents`. None: all but external ones.
    comparison
        What counts as equal.
    progress
        Called with the number of each cycle that is done, and the number of all.

    Raises
    ------
    InputError
        There is no such recording or node, or the recording holds nothing to compare.
    """
    with RunReader(run) as reader:
        plan, stop_cycle = reader.plan, reader.stop_cycle
        team, left_out = _team(plan, nodes, reader.path)
        walk = CycleWalk(
            reader.messages(),
            plan.tree,
            plan.cycles,
            plan.external,
            max(MOST_HELD, len(plan.keys.ports) * (plan.periods.longest + 2)),
        )
        recent, clocked = RecentMessages(plan), on_a_clock(plan)
        reruns = [
            AgentRerun(name, make, plan, clocked, walk, recent, stop_cycle, comparison)
            for name, make in team.items()
        ]
        cycles = 0
        for cycle in walk:
            if stop_cycle is not None and cycle.number >= stop_cycle:
                break  # Some may have begun it all the same.
            recent.add(cycle)
            for rerun in reruns:
                rerun.take(cycle)
            cycles += bool(cycle.messages)
            progress(cycle.number, plan.cycles)
        found = Verification(
            reader.path,
            plan,
            reader.whole,
            stop_cycle,
            max(walk.newest.values()),
            cycles,
            walk.read,
            walk.not_decided,
            walk.strays,
            sum(walk.too_late[name] for name in team if name not in plan.external),
            {rerun.name: rerun.account for rerun in reruns},
            left_out,
        )
    if not found.compared and found.equal:
        raise InputError(f"{found.recording}: no message of {', '.join(team)}: nothing to verify")
    return found


def select_agents(plan: RunPlan, nodes: Sequence[str]) -> tuple[str, ...]:
    """Return the agents that are meant, in the order of the control tree; none named: all.

    Raises
    ------
    InputError
        There is no such agent.
    """
    team = (PLANT, *(agent_name(path) for path in plan.tree.nodes))
    chosen = find_agents(plan.tree, nodes) or team
    return tuple(name for name in team if name in chosen)


def run_profile(plan: RunPlan, recording: Path) -> Profile | None:
    """Return the profile that lies beside a recording, None if there is none.

    Raises
    ------
    InputError
        It is damaged, or the profile of another run.
    """
    path = recording.with_name(PROFILE_NAME)
    if not path.exists():
        return None
    profile = load_profile(path)
    shape = (plan.cycles, len(plan.inverters))
    if profile.mpp_kw.shape != shape:
        raise InputError(
            f"{path}: {profile.mpp_kw.shape} cycles and inverters, expected the profile of the "
            f"recorded run, {shape}"
        )
    return profile


def _team(
    plan: RunPlan, nodes: Sequence[str], recording: Path
) -> tuple[dict[str, _Make], dict[str, str]]:
    """Return how each agent is made, and the agents that are left out, with the reason.

    The plant is re-run if the run's profile is there, an external agent if it is asked for: what
    Heliarch's own would publish in its place, it need not have published.
    """
    team: dict[str, _Make] = {}
    left_out: dict[str, str] = {}
    for name in select_agents(plan, nodes):
        if name in plan.external and not nodes:
            left_out[name] = "it is external"
        elif name != PLANT:
            team[name] = partial(controller, plan, name)
        elif (profile := run_profile(plan, recording)) is not None:
            team[name] = partial(Plant, plan, profile)
        elif nodes:
            raise InputError(
                f"--node {PLANT}: it can be re-run if {PROFILE_NAME} lies beside {recording}"
            )
        else:
            left_out[name] = f"no {PROFILE_NAME} lies beside the recording"
    return team, left_out
