"""Verifies a recorded run: which agents, on which recording, with what result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Final, TypeAlias

from agents.cycle import stage_place
from agents.plan import RunPlan
from agents.team import Controller, central_controller, direct_controller, supervisor
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import Port, ports
from bus_schemas.tree import CENTRAL, PLANT, agent_name
from launch_scripts.verification.account import Account, Difference
from launch_scripts.verification.comparison import Comparison
from launch_scripts.verification.recorded_cycles import CycleWalk
from launch_scripts.verification.rerun import AgentRerun
from recordings.reader import RunReader
from sim_plant.plant import Plant
from sim_plant.profile import Profile, load_profile

PROFILE_NAME: Final = "profile.npz"

_SUBTREE: Final = "/*"

_CUT_OFF_CYCLES: Final = 3
"""In the last cycles of a run that broke off messages are missing, and that is no finding."""

_Make: TypeAlias = Callable[[], Controller]


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
        The first cycle that did not take place, by the plant's word; None if the run broke off.
    last_cycle
        The last cycle of which the recording holds anything.
    cycles
        Cycles of which the recording holds anything.
    recorded
        Messages in the recording, of all agents.
    not_decided
        Those of them that no agent decides: the beginning and end of the run, and what processes
        count of themselves. They are not compared.
    strays
        Messages that belong to no cycle of the run, or that lie too far from theirs.
    external_strays
        Those of external agents, by agent: they decide nothing.
    not_awaited
        Messages of agents that were re-run that lie too far behind their cycle, after others had
        been held back for them as long as memory allows.
    accounts
        Of each agent that was re-run.
    plant_left_out
        Whether the plant would have been re-run if the run's profile were there.
    external
        Accounts of external agents: what Heliarch's own say in their place. Nobody holds them to
        it, so their differences do not count, unless they were asked for by name.
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
    external_strays: dict[str, int]
    not_awaited: int
    accounts: dict[str, Account]
    plant_left_out: bool
    external: dict[str, Account] = field(default_factory=dict)

    @property
    def compared(self) -> int:
        """Pairs of messages that were held against each other."""
        return sum(account.compared for account in self.accounts.values())

    @property
    def differences(self) -> int:
        """Number of differences, of all agents."""
        return sum(account.counts.total() for account in self.accounts.values())

    @property
    def not_compared(self) -> int:
        """Messages that could not be compared, since others are lost or their agent failed."""
        left_out = sum(account.not_compared for account in self.accounts.values())
        return left_out + self.not_awaited

    @property
    def undecided(self) -> bool:
        """Whether messages could not be compared other than where a run broke off."""
        if self.stop_cycle is not None or self.not_awaited:
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
        last = stage_place(PLANT, "advance", tree)
        try:
            place = stage_place(agent, difference.stage, tree)
        except KeyError:  # No stage sends it, or one that the code under test has invented.
            place = last
        return difference.cycle, place

    @property
    def missed_inputs(self) -> int:
        """Inputs that the agents had to do without when the run was recorded."""
        return sum(account.missed_inputs for account in self.accounts.values())

    @property
    def late_used(self) -> int:
        """Late words that the agents used when the run was recorded."""
        return sum(account.late_used for account in self.accounts.values())

    @property
    def equal(self) -> bool:
        """Whether every agent says what it said, as far as the recording can tell."""
        return not self.differences and not self.strays and not self.undecided


def verify(
    run: Path,
    nodes: Sequence[str],
    comparison: Comparison,
    progress: Callable[[int, int], None] = lambda cycle, cycles: None,
) -> Verification:
    """Re-run agents on the inputs of a recording and compare what they say.

    Parameters
    ----------
    run
        Folder of the run, or its MCAP file.
    nodes
        Agents to re-run, see `select_agents`. None: all.
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
        plan = reader.plan
        names = select_agents(plan, nodes)
        foreign = set() if nodes else set(plan.external)
        if PLANT in foreign:  # Its sky is its own.
            names = tuple(name for name in names if name != PLANT)
        team, plant_left_out = _team(plan, names, reader.path, asked_for=bool(nodes))
        says = _ports_by_publisher(plan)
        reruns = [
            AgentRerun(name, make, says[name], plan, comparison) for name, make in team.items()
        ]
        messages = reader.messages(by_time=False)
        walk = CycleWalk(messages, plan.tree, plan.cycles, external=plan.external)
        cycles = 0
        for cycle in walk:
            for rerun in reruns:
                rerun.take(cycle)
            cycles += bool(cycle.messages)
            progress(cycle.number, plan.cycles)
        for rerun in reruns:
            rerun.conclude(walk.stop_cycle, walk.newest)
        found = Verification(
            reader.path,
            plan,
            reader.whole,
            walk.stop_cycle,
            max(walk.newest.values(), default=-1),
            cycles,
            walk.read,
            walk.not_decided,
            walk.strays,
            dict(walk.external_strays),
            sum(walk.not_awaited[rerun.name] for rerun in reruns),
            {rerun.name: rerun.account for rerun in reruns if rerun.name not in foreign},
            plant_left_out,
            {rerun.name: rerun.account for rerun in reruns if rerun.name in foreign},
        )
    if not found.compared and found.equal:
        raise InputError(f"{found.recording}: no message of {', '.join(names)}: nothing to verify")
    return found


def select_agents(plan: RunPlan, nodes: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the agents that are meant, in the order of the control tree.

    Parameters
    ----------
    plan
        Of the run.
    nodes
        Names of agents: `plant`, `central`, paths such as `c2` or `c1/inv07`; `c2/*` is `c2` and
        all below it. None: all agents.

    Raises
    ------
    InputError
        There is no such agent; with the names that come near.
    """
    team = (PLANT, *(agent_name(path) for path in plan.tree.nodes))
    chosen: set[str] = set() if nodes else set(team)
    for node in nodes:
        top = node.removesuffix(_SUBTREE)
        if top not in team or (top != node and top in {PLANT, CENTRAL}):
            near = get_close_matches(top, team, n=4, cutoff=0.5) or team[:4]
            raise InputError(
                f"--node {node}: this run has no such agent, near it: {', '.join(near)}; "
                f"NAME{_SUBTREE} is a supervisor with all below it"
            )
        chosen.add(top)
        if top != node:
            chosen.update(name for name in team if name.startswith(top + "/"))
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
            f"{path}: {profile.mpp_kw.shape} cycles and inverters, accepted is the profile of the "
            f"recorded run, {shape}"
        )
    return profile


def _team(
    plan: RunPlan, names: Sequence[str], recording: Path, *, asked_for: bool
) -> tuple[dict[str, _Make], bool]:
    """Return how each agent is made; the plant only if the profile of the run is there."""
    team: dict[str, _Make] = {name: partial(_controller, plan, name) for name in names}
    if PLANT not in names:
        return team, False
    profile = run_profile(plan, recording)
    if profile is not None:
        return team | {PLANT: partial(Plant, plan.tree, profile, plan.actuator)}, False
    if asked_for:
        raise InputError(
            f"--node {PLANT}: it can be re-run if {PROFILE_NAME} lies beside {recording}"
        )
    del team[PLANT]
    return team, True


def _controller(plan: RunPlan, name: str) -> Controller:
    if name == CENTRAL:
        return central_controller(plan)
    return direct_controller(plan, name) if name in plan.tree.leaves else supervisor(plan, name)


def _ports_by_publisher(plan: RunPlan) -> dict[str, list[Port[Message]]]:
    """Return for each agent the ports of its recorded outputs: of what it decides."""
    found: dict[str, list[Port[Message]]] = {}
    for port in ports(plan.tree):
        if port.signal.logged and port.signal.decided:
            found.setdefault(port.publisher, []).append(port)
    return found
