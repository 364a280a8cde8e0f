"""Whether a rule of faults fits the run: its fields, the ends of its links, what it stops."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from fnmatch import fnmatchcase
from itertools import chain

from bus_schemas.errors import InputError
from bus_schemas.faults import UNHEARD, FaultRule, links, stopped_by
from bus_schemas.tree import RECORDER, ControlTree, agent_name, some_of


def check_rule(
    rule: FaultRule,
    tree: ControlTree,
    where: str,
    external: Collection[str] = (),
    addresses: Mapping[str, str] = {},
) -> None:
    """Refuse a rule that does not fit the run.

    where: What the user calls it.
    external: Agents whose programs are not Heliarch's: nothing can be done to what comes in there.
    addresses: Where the agents are that run on other hosts: their processes cannot be stopped from
        here.
    """
    to_agents = _to_links(rule, tree, external)
    if rule.stops is not None:
        to_agents = _to_stopped(rule, tree, external, addresses)
    for objection in chain(_to_fields(rule), to_agents):
        raise InputError(f"{where}: {objection}")


def _to_fields(rule: FaultRule) -> Iterator[str]:
    """Yield what the bounds of the fields do not say."""
    if rule.distribution == "fixed" and rule.jitter_ms:
        yield "distribution: expected uniform or normal with jitter, got fixed"
    if rule.reorder and not rule.held_back_ms:
        yield "reorder_ms: expected a time above 0 with reorder, got none"
    for begin_s, end_s in rule.silent:
        if begin_s >= end_s:
            times = f"{begin_s:g} s to {end_s:g} s"
            yield f"silent: expected an end after the beginning, got {times}"
    doing = [name for name in ("partition", "kill", "freeze") if getattr(rule, name) is not None]
    if not (rule.acts_outside_silence or rule.silent or doing):
        yield (
            "expected a delay, jitter, loss, duplicate, reorder, silent, partition, kill or "
            "freeze, got none"
        )
    alone = FaultRule(**{name: getattr(rule, name) for name in ("at", *doing[:1])})
    if doing and rule != alone:
        yield f"expected {doing[0]} and at alone in a rule, got more"
    wanted = {1} if rule.kill is not None else {2} if rule.freeze is not None else {0, 2}
    if len(rule.at) not in wanted or list(rule.at) != sorted(set(rule.at)):
        form = "one time such as 30s" if wanted == {1} else "beginning and end such as 30s..45s"
        got = "..".join(f"{time_s:g}s" for time_s in rule.at) or "none"
        yield f"at: expected {form}, got {got}"
    if rule.partition is not None and rule.partition.count("|") != 1:
        yield f"partition: expected two agents such as c1|central, got {rule.partition}"


def _to_stopped(
    rule: FaultRule, tree: ControlTree, external: Collection[str], addresses: Mapping[str, str]
) -> Iterator[str]:
    names = [agent_name(node) for node in tree.nodes]
    found = stopped_by(rule, tree)
    if not found:
        known = f"a controller ({some_of(names)}), or a pattern such as c1/*"
        yield f"expected {known}, got {rule.stops!r}"
    for name in found:
        if name in external:
            yield f"expected controllers that Heliarch runs, got the external {name}"
        if name in addresses:
            yield f"expected controllers on this host, got {name} on {addresses[name]}"


def _to_links(rule: FaultRule, tree: ControlTree, external: Collection[str]) -> Iterator[str]:
    agents = [agent for agent in tree.agents() if agent != RECORDER]
    fields = ("source", "listener") if rule.partition is None else ("partition", "partition")
    for field, pattern in zip(fields, rule.ends[0], strict=True):
        if not any(fnmatchcase(agent, pattern) for agent in agents):
            known = f"{some_of(agents)}, or a pattern such as c1/*"
            yield f"{field}: expected {known}, got {pattern!r}"
    if rule.signal in UNHEARD:
        return  # No agent acts on it, so that losing it costs nothing.
    every = links(tree)
    names = dict.fromkeys(port.signal.name for port, _ in every)
    if rule.signal is not None and rule.signal not in names:
        yield f"signal: expected {', '.join(names)}, got {rule.signal!r}"
    heard_by = dict.fromkeys(listener for port, listener in every if rule.acts_on(port, listener))
    if not heard_by and rule.partition is not None:
        yield f"partition: expected agents that hear each other, got {rule.partition}"
    if not heard_by:
        instead = dict.fromkeys(
            f"{port.signal.name} to {listener}"
            for port, listener in every
            if fnmatchcase(port.publisher, rule.source)
        )
        got = f"{rule.signal or 'anything'} from {rule.source} to {rule.listener}"
        yield f"expected one of {some_of(list(instead))}, got {got}, which is never sent"
    if heard_by.keys() <= set(external):
        yield (
            f"expected a listener that Heliarch runs, where faults act, got external agents alone "
            f"({', '.join(heard_by)})"
        )
