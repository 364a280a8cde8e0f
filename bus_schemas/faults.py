"""Faults: rules that delay, lose, duplicate or hold back messages on links, and stop processes.

A link goes from the publisher of a port to one of its listeners. The recorder hears everything: a
recording says what was sent, and `missing` in its messages what did not come.

The words are those of network emulation in Linux, tc-netem(8), but `reorder` holds a share of the
messages back, so that later ones overtake it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from fnmatch import fnmatchcase
from itertools import chain
from typing import Annotated, Final, Literal, NamedTuple, TypeAlias

import msgspec
from msgspec import Meta

from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import SIGNALS, Port, listeners, ports
from bus_schemas.tree import RECORDER, ControlTree, agent_name, some_of

UNHEARD: Final = frozenset(
    signal.name for signal in SIGNALS if signal.is_cyclic and not signal.listeners
)
"""Cyclic signals that no agent acts on: what becomes of them changes nothing in a run."""

Share: TypeAlias = Annotated[float, Meta(ge=0.0, le=1.0)]
Milliseconds: TypeAlias = Annotated[float, Meta(ge=0.0, le=3_600_000.0)]
Second: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e12)]


class FaultRule(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One way in which links are imperfect.

    source: Publishing agent: `plant`, `c2/inv07`, or a pattern such as `c1/*`.
    listener: Receiving agent, named in the same way.
    signal: Name of a cyclic signal. Default: any.
    delay_ms: Delay of each message [ms].
    jitter_ms: Spread of the delay [ms]; it is never below 0.
    distribution: How delays are spread; `jitter_ms` is the range (±) or standard deviation.
    loss: Share of the messages that do not arrive.
    duplicate: Share that arrives twice; the copy has its own delay and loss.
    reorder: Share that is held back, so that later messages overtake it.
    reorder_ms: Extra delay when held back [ms]. Default: one more `delay_ms`.
    silent: Intervals of simulated time since cycle 0 in which nothing arrives [s].
    partition: Two agents, or patterns, that do not hear each other: `c1|central`.
    kill: Controllers that are killed `at` a time: `c1`, `c2/*`.
    freeze: Controllers that stand still between the two times of `at`.
    at: When, in simulated time since cycle 0 [s]: one time for `kill`, beginning and end for other
        rules. Default: always.
    """

    source: str = "*"
    listener: str = "*"
    signal: str | None = None
    delay_ms: Milliseconds = 0.0
    jitter_ms: Milliseconds = 0.0
    distribution: Literal["fixed", "uniform", "normal"] = "uniform"
    loss: Share = 0.0
    duplicate: Share = 0.0
    reorder: Share = 0.0
    reorder_ms: Milliseconds | None = None
    silent: tuple[tuple[Second, Second], ...] = ()
    partition: str | None = None
    kill: str | None = None
    freeze: str | None = None
    at: Annotated[tuple[Second, ...], Meta(max_length=2)] = ()

    def __str__(self) -> str:
        """Return the rule as `--fault` reads it, without the defaults."""
        words = []
        for field in msgspec.structs.fields(self):
            name, value = field.name, getattr(self, field.name)
            if name in {"silent", "at"} or value == field.default:
                continue
            if name.endswith("_ms"):
                name = "reorder-by" if name == "reorder_ms" else name.removesuffix("_ms")
                value = f"{value}ms"
            words.append(f"{name}={value}")
        words += [f"silent={begin:.15g}s..{end:.15g}s" for begin, end in self.silent]
        if self.at:
            words.append("at=" + "..".join(f"{time_s:.15g}s" for time_s in self.at))
        return ",".join(words)

    @property
    def held_back_ms(self) -> float:
        """How much longer than the others a message takes that is held back [ms]."""
        return self.delay_ms if self.reorder_ms is None else self.reorder_ms

    @property
    def acts_outside_silence(self) -> bool:
        """Whether it does more than to be silent at times."""
        return any((self.delay_ms, self.jitter_ms, self.loss, self.duplicate, self.reorder))

    def is_silent(self, time_s: float) -> bool:
        """Whether nothing arrives at a simulated time since cycle 0."""
        is_cut = self.partition is not None and self.is_active(time_s)
        return is_cut or any(begin_s <= time_s < end_s for begin_s, end_s in self.silent)

    def is_active(self, time_s: float) -> bool:
        return not self.at or self.at[0] <= time_s < self.at[1]

    @property
    def stops(self) -> str | None:
        """The controllers, or a pattern of them, that the rule kills or freezes."""
        return self.kill or self.freeze

    @property
    def ends(self) -> tuple[tuple[str, str], ...]:
        """Publisher and listener, or patterns of them, of its links."""
        if self.partition is None:
            return ((self.source, self.listener),)
        one, other = self.partition.split("|")
        return (one, other), (other, one)

    def acts_on(self, port: Port[Message], listener: str) -> bool:
        if self.stops is not None or not port.signal.is_cyclic:
            return False
        return self.signal in {None, port.signal.name} and any(
            fnmatchcase(port.publisher, source) and fnmatchcase(listener, heard_by)
            for source, heard_by in self.ends
        )


class Incident(NamedTuple):
    """Something that happens to a process at a simulated time since cycle 0 [s]."""

    time_s: float
    agent: str
    what: Literal["kill", "freeze", "thaw", "watch", "start"]


def incidents(rules: tuple[FaultRule, ...], tree: ControlTree) -> list[Incident]:
    found = []
    for rule in rules:
        for agent in stopped_by(rule, tree):
            found.append(Incident(rule.at[0], agent, "kill" if rule.kill else "freeze"))
            if rule.freeze:
                found.append(Incident(rule.at[1], agent, "thaw"))
    return sorted(found)


def stopped_by(rule: FaultRule, tree: ControlTree) -> list[str]:
    names = [agent_name(node) for node in tree.nodes]
    return [name for name in names if fnmatchcase(name, rule.stops or "")]


def links(tree: ControlTree) -> list[tuple[Port[Message], str]]:
    """Each port of a cyclic signal with each agent that acts on it."""
    return [
        (port, listener)
        for port in ports(tree)
        if port.signal.is_cyclic
        for listener in listeners(port, tree)
    ]


def check_rule(
    rule: FaultRule,
    tree: ControlTree,
    where: str,
    external: Collection[str] = (),
    addresses: Mapping[str, str] = {},
) -> None:
    """Refuse a rule that does not fit the run.

    external: Agents that Heliarch does not run: faults cannot act on what they receive.
    addresses: Of the agents on other hosts: their processes cannot be stopped from here.
    """
    to_agents = _to_links(rule, tree, external)
    if rule.stops is not None:
        to_agents = _to_stopped(rule, tree, {*external, *addresses})
    for objection in chain(_to_fields(rule), to_agents):
        raise InputError(f"{where}: {objection}")


def _to_fields(rule: FaultRule) -> Iterator[str]:
    if rule.distribution == "fixed" and rule.jitter_ms:
        yield "distribution: expected uniform or normal with jitter, got fixed"
    if rule.reorder and not rule.held_back_ms:
        yield "reorder: expected a delay or reorder-by (reorder_ms) above 0 with it, got none"
    for begin_s, end_s in rule.silent:
        if begin_s >= end_s:
            yield f"silent: expected an end after the beginning {begin_s:g} s, got {end_s:g} s"
    doing = [name for name in ("partition", "kill", "freeze") if getattr(rule, name) is not None]
    if not (rule.acts_outside_silence or rule.silent or doing):
        yield "expected a delay, loss, kill or other fault, got none"
    alone = FaultRule(**{name: getattr(rule, name) for name in ("at", *doing[:1])})
    if doing and rule != alone:
        yield f"expected only {doing[0]} and at in this rule, got more"
    wanted = {1} if rule.kill is not None else {2} if rule.freeze is not None else {0, 2}
    if len(rule.at) not in wanted or list(rule.at) != sorted(set(rule.at)):
        form = "one time such as 30s" if rule.kill else "beginning and end such as 30s..45s"
        yield f"at: expected {form}, got {rule}"
    if rule.partition is not None and rule.partition.count("|") != 1:
        yield f"partition: expected two agents such as c1|central, got {rule.partition}"


def _to_stopped(rule: FaultRule, tree: ControlTree, elsewhere: set[str]) -> Iterator[str]:
    found = stopped_by(rule, tree)
    if not found or not elsewhere.isdisjoint(found):
        names = [name for name in map(agent_name, tree.nodes) if name not in elsewhere]
        yield f"expected controllers of this host, such as {some_of(names)}, got {rule.stops!r}"


def _to_links(rule: FaultRule, tree: ControlTree, external: Collection[str]) -> Iterator[str]:
    agents = [agent for agent in tree.agents() if agent != RECORDER]
    fields = ("source", "listener") if rule.partition is None else ("partition", "partition")
    for field, pattern in zip(fields, rule.ends[0], strict=True):
        if not any(fnmatchcase(agent, pattern) for agent in agents):
            known = f"{some_of(agents)}, or a pattern such as c1/*"
            yield f"{field}: expected {known}, got {pattern!r}"
    if rule.signal in UNHEARD:
        return  # No agent acts on it, so losing it costs nothing.
    every = links(tree)
    names = dict.fromkeys(port.signal.name for port, _ in every)
    if rule.signal is not None and rule.signal not in names:
        yield f"signal: expected {', '.join(names)}, got {rule.signal!r}"
    heard_by = dict.fromkeys(listener for port, listener in every if rule.acts_on(port, listener))
    if not heard_by:
        field = "" if rule.partition is None else "partition: "
        yield f"{field}expected agents of which one hears the other, got {rule}"
    if heard_by.keys() <= set(external):
        yield f"expected a listener that Heliarch runs, got only {', '.join(heard_by)}"
