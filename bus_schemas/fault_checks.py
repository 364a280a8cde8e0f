"""Whether a rule of faults fits the run: its fields, the ends of its links, what it stops."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from fnmatch import fnmatchcase

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
    _check_fields(rule, where)
    if rule.partition is not None and rule.partition.count("|") != 1:
        raise InputError(
            f"{where}: partition: expected two agents such as c1|central, got {rule.partition}"
        )
    if rule.stops is not None:
        _check_stopped(rule, tree, where, external, addresses)
    else:
        _check_links(rule, tree, where, external)


def _check_fields(rule: FaultRule, where: str) -> None:
    """Check what the bounds of the fields do not say."""
    if rule.distribution == "fixed" and rule.jitter_ms:
        raise InputError(
            f"{where}: distribution: expected uniform or normal with jitter, got fixed"
        )
    if rule.reorder and not rule.held_back_ms:
        raise InputError(
            f"{where}: reorder: expected a delay or reorder-by (in a scenario delay_ms or "
            "reorder_ms) above 0 with it, got none"
        )
    for begin_s, end_s in rule.silent:
        if begin_s >= end_s:
            raise InputError(
                f"{where}: silent: expected an end after the beginning, got {begin_s:g} s to "
                f"{end_s:g} s"
            )
    doing = [name for name in ("partition", "kill", "freeze") if getattr(rule, name) is not None]
    if not (rule.acts_outside_silence or rule.silent or doing):
        raise InputError(
            f"{where}: expected a delay, jitter, loss, duplicate, reorder, silent, partition, kill "
            "or freeze, got none"
        )
    if len(doing) > 1 or (doing and not _does_only(rule, doing[0])):
        raise InputError(f"{where}: expected {doing[0]} and at alone in a rule, got more")
    wanted = {1} if rule.kill is not None else {2} if rule.freeze is not None else {0, 2}
    if len(rule.at) not in wanted or list(rule.at) != sorted(set(rule.at)):
        form = "one time such as 30s" if wanted == {1} else "beginning and end such as 30s..45s"
        got = "..".join(f"{time_s:g}s" for time_s in rule.at) or "none"
        raise InputError(f"{where}: at: expected {form}, got {got}")


def _does_only(rule: FaultRule, name: str) -> bool:
    return FaultRule(**{name: getattr(rule, name), "at": rule.at}) == rule


def _check_stopped(
    rule: FaultRule,
    tree: ControlTree,
    where: str,
    external: Collection[str],
    addresses: Mapping[str, str],
) -> None:
    names = [agent_name(node) for node in tree.nodes]
    found = stopped_by(rule, tree)
    if not found:
        raise InputError(
            f"{where}: expected a controller ({some_of(names)}), or a pattern such as c1/*, got "
            f"{rule.stops!r}"
        )
    for name in found:
        if name in external:
            raise InputError(
                f"{where}: expected controllers that Heliarch runs, got the external {name}"
            )
        if name in addresses:
            raise InputError(
                f"{where}: expected controllers on this host, got {name} on {addresses[name]}"
            )


def _check_links(rule: FaultRule, tree: ControlTree, where: str, external: Collection[str]) -> None:
    agents = [agent for agent in tree.agents() if agent != RECORDER]
    fields = ("source", "listener") if rule.partition is None else ("partition", "partition")
    for field, pattern in zip(fields, rule.ends[0], strict=True):
        if not any(fnmatchcase(agent, pattern) for agent in agents):
            raise InputError(
                f"{where}: {field}: expected {some_of(agents)}, or a pattern such as c1/*, got "
                f"{pattern!r}"
            )
    if rule.signal in UNHEARD:
        return  # No agent acts on it, so that losing it costs nothing.
    every = links(tree)
    names = dict.fromkeys(port.signal.name for port, _ in every)
    if rule.signal is not None and rule.signal not in names:
        raise InputError(f"{where}: signal: expected {', '.join(names)}, got {rule.signal!r}")
    heard_by = dict.fromkeys(listener for port, listener in every if rule.acts_on(port, listener))
    if not heard_by and rule.partition is not None:
        raise InputError(
            f"{where}: partition: expected agents that hear each other, got {rule.partition}"
        )
    if not heard_by:
        instead = dict.fromkeys(
            f"{port.signal.name} to {listener}"
            for port, listener in every
            if fnmatchcase(port.publisher, rule.source)
        )
        raise InputError(
            f"{where}: expected one of {some_of(list(instead))}, got {rule.signal or 'anything'} "
            f"from {rule.source} to {rule.listener}, which is never sent"
        )
    if heard_by.keys() <= set(external):
        raise InputError(
            f"{where}: expected a listener that Heliarch runs, where faults act, got external "
            f"agents alone ({', '.join(heard_by)})"
        )
