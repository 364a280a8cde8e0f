"""Faults of a run: those of its links, and those of its processes, which are killed or frozen."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from fnmatch import fnmatchcase
from typing import Literal, NamedTuple, TypeAlias

from bus_schemas.errors import InputError, listed
from bus_schemas.faults import Interval, LinkFault, Rule, Second, link_objections
from bus_schemas.tree import ControlTree, agent_name
from bus_schemas.wiring import Wiring


class Kill(Rule, frozen=True, tag="kill"):
    """Controllers are killed.

    agents: Name or pattern: `c1`, `c2/*`.
    at: Simulated time since cycle 0 [s].
    """

    agents: str
    at: Second


class Freeze(Rule, frozen=True, tag="freeze"):
    """Controllers stand still.

    agents: Name or pattern: `c1`, `c2/*`.
    at: Beginning and end, since cycle 0 [s].
    """

    agents: str
    at: Interval


class Trip(Rule, frozen=True, tag="trip"):
    """Inverters draw standby power instead of giving any. Controllers go on.

    agents: Path or pattern: `c1/inv01`, `c2/*`.
    at: Beginning and end, since cycle 0 [s].
    """

    agents: str
    at: Interval


ProcessFault: TypeAlias = Kill | Freeze | Trip
Fault: TypeAlias = LinkFault | ProcessFault


class Incident(NamedTuple):
    """Something that happens to an agent at a simulated time since cycle 0 [s]."""

    time_s: float
    agent: str
    what: Literal["kill", "freeze", "thaw"]


def incidents(faults: Sequence[Fault], tree: ControlTree, wiring: Wiring) -> list[Incident]:
    """Return what happens to all agents of a process by the faults of a run, in order."""
    due: list[Incident] = []
    for fault in faults:
        if not isinstance(fault, Kill | Freeze):
            continue
        processes = dict.fromkeys(map(wiring.process_of, _stopped(fault, tree)))
        stopped = [agent for process in processes for agent in wiring.members[process]]
        match fault:
            case Kill():
                due += (Incident(fault.at, agent, "kill") for agent in stopped)
            case Freeze(at=(begin_s, end_s)):
                for agent in stopped:
                    due += Incident(begin_s, agent, "freeze"), Incident(end_s, agent, "thaw")
    return sorted(due)


def trips(faults: Sequence[Fault], devices: Sequence[str], time_s: float) -> list[bool]:
    """Return whether each device is tripped at a simulated time since cycle 0 [s]."""
    active = [one for one in faults if isinstance(one, Trip) and one.at[0] <= time_s < one.at[1]]
    return [any(fnmatchcase(leaf, one.agents) for one in active) for leaf in devices]


def check_fault(
    fault: Fault,
    tree: ControlTree,
    where: str,
    external: Collection[str] = (),
    addresses: Collection[str] = (),
) -> None:
    """Refuse a fault that does not fit the run.

    external: Agents that Heliarch does not run: faults cannot act on their inputs.
    addresses: Agents on other hosts: their processes cannot be stopped from here.
    """
    if not isinstance(fault, ProcessFault):
        for objection in link_objections(fault, tree, external):
            raise InputError.of(where, objection)
        return
    away, stopped = {*external, *addresses}, _stopped(fault, tree)
    if isinstance(fault, Trip):
        stopped = [name for name in stopped if tree.is_leaf(name)]
    if not stopped or not away.isdisjoint(stopped):
        names = [name for name in map(agent_name, tree.nodes) if name not in away]
        expected = f"controllers of this host, such as {listed(names)}"
        raise InputError.of(where, f"expected {expected}, got {fault.agents!r}")


def _stopped(fault: ProcessFault, tree: ControlTree) -> list[str]:
    names = map(agent_name, tree.nodes)
    return [name for name in names if fnmatchcase(name, fault.agents)]
