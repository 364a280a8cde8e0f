"""Faults: rules that delay, lose, double or hold back messages on links, and stop processes.

A link goes from the publisher of a port to one of its listeners. What becomes of a message on a
link is drawn from a hash of the seed, the rule, the link and the message's cycle, and from nothing
else: not from the order in which things happen. So a message has the same fate over processes, in
memory, and when the run is repeated. The faults act on the way to the listener who acts on the
message. The recorder hears everything: a recording says what was sent, and the inputs that its
messages name as `missing` say what did not come.

The words are those of network emulation in Linux, `tc netem` [1]_: delay, jitter, distribution,
loss, duplicate, reorder. Two differ. `reorder` there lets a share of delayed packets pass at once;
here it holds a share back, so that later messages overtake them, since a message of each cycle
that came early would overtake nothing. And `silent` is not there: netem is switched from outside.

References
----------
.. [1] tc-netem(8), iproute2 manual pages.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from hashlib import blake2b
from math import ceil, cos, inf, log, pi, sqrt
from typing import Annotated, Final, Literal, NamedTuple, TypeAlias

import msgspec
from msgspec import Meta

from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import SIGNALS, Port, listeners, ports
from bus_schemas.tree import RECORDER, ControlTree, agent_name, some_of

LONGEST_MS: Final = 3_600_000.0
"""Longest delay, jitter or holding back that is accepted: an hour."""

UNHARMED: Final[tuple[int, ...]] = (0,)
"""Fate of a message that one copy of arrives at once."""

UNHEARD: Final = frozenset(
    signal.name for signal in SIGNALS if signal.is_cyclic and not signal.listeners
)
"""Cyclic signals that no agent acts on: what becomes of them changes nothing in a run."""

_LOST: Final[tuple[int, ...]] = ()
_MOST_SIGMAS: Final = sqrt(-2.0 * log(2.0**-53))
"""No normal number that is made of 53 bits is further from the mean: 8.6 standard deviations."""


Share: TypeAlias = Annotated[float, Meta(ge=0.0, le=1.0)]
Milliseconds: TypeAlias = Annotated[float, Meta(ge=0.0, le=LONGEST_MS)]
Second: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e12)]


class FaultRule(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One way in which links are imperfect."""

    source: Annotated[
        str, Meta(description="Publishing agent: `plant`, `c2/inv07`, or a pattern such as `c1/*`.")
    ] = "*"
    listener: Annotated[str, Meta(description="Receiving agent, named in the same way.")] = "*"
    signal: Annotated[str | None, Meta(description="Name of a cyclic signal. Default: any.")] = None
    delay_ms: Annotated[Milliseconds, Meta(description="Delay of each message [ms].")] = 0.0
    jitter_ms: Annotated[
        Milliseconds, Meta(description="Spread of the delay [ms]; it is never below 0.")
    ] = 0.0
    distribution: Annotated[
        Literal["fixed", "uniform", "normal"],
        Meta(description="Of the delay; `jitter_ms` is its range (±) or standard deviation."),
    ] = "uniform"
    loss: Annotated[Share, Meta(description="Share of the messages that do not arrive.")] = 0.0
    duplicate: Annotated[
        Share, Meta(description="Share that arrives twice; the copy has its own delay and loss.")
    ] = 0.0
    reorder: Annotated[
        Share, Meta(description="Share that is held back, so that later messages overtake it.")
    ] = 0.0
    reorder_ms: Annotated[
        Milliseconds | None,
        Meta(description="Extra delay when held back [ms]. Default: one more `delay_ms`."),
    ] = None
    silent: Annotated[
        tuple[tuple[Second, Second], ...],
        Meta(description="Intervals of simulated time since cycle 0 in which nothing arrives [s]."),
    ] = ()
    partition: Annotated[
        str | None,
        Meta(description="Two agents, or patterns, that do not hear each other: `c1|central`."),
    ] = None
    kill: Annotated[
        str | None, Meta(description="Controllers that are killed `at` a time: `c1`, `c2/*`.")
    ] = None
    freeze: Annotated[
        str | None, Meta(description="Controllers that stand still between the two times of `at`.")
    ] = None
    at: Annotated[
        tuple[Second, ...],
        Meta(
            description="When, in simulated time since cycle 0 [s]: one time for `kill`, beginning "
            "and end for other rules. Default: always.",
            max_length=2,
        ),
    ] = ()

    def __str__(self) -> str:
        """Return the rule as `--fault` reads it, without the defaults."""
        default = {field.name: field.default for field in msgspec.structs.fields(self)}
        given = msgspec.structs.asdict(self)
        del given["silent"], given["at"]
        words = [_option(name, value) for name, value in given.items() if value != default[name]]
        words += [f"silent={begin:.15g}s..{end:.15g}s" for begin, end in self.silent]
        if self.at:
            words.append("at=" + "..".join(f"{time_s:.15g}s" for time_s in self.at))
        return ",".join(words)

    @property
    def held_back_ms(self) -> float:
        """How much longer than the others a message takes that is held back [ms]."""
        return self.delay_ms if self.reorder_ms is None else self.reorder_ms

    @property
    def longest_ms(self) -> float:
        """The longest delay that can be drawn, held back and all [ms]."""
        spread = _MOST_SIGMAS if self.distribution == "normal" else 1.0
        held_back_ms = self.held_back_ms if self.reorder else 0.0
        return self.delay_ms + spread * self.jitter_ms + held_back_ms

    @property
    def acts_outside_silence(self) -> bool:
        """Whether it does more than to be silent at times."""
        return any((self.delay_ms, self.jitter_ms, self.loss, self.duplicate, self.reorder))

    @property
    def spans(self) -> tuple[tuple[float, ...], ...]:
        """Intervals of simulated time since cycle 0 in which it does something to messages [s]."""
        acts = self.acts_outside_silence or self.partition is not None
        return (*self.silent, self.at or (0.0, inf)) if acts else self.silent

    def is_silent(self, time_s: float) -> bool:
        """Whether nothing arrives at a simulated time since cycle 0."""
        is_cut = self.partition is not None and self.is_active(time_s)
        return is_cut or any(begin_s <= time_s < end_s for begin_s, end_s in self.silent)

    def is_active(self, time_s: float) -> bool:
        """Whether the rule acts at a simulated time since cycle 0, silence aside."""
        return not self.at or self.at[0] <= time_s < self.at[1]

    @property
    def stops(self) -> str | None:
        """The controllers, or a pattern of them, that the rule kills or freezes."""
        return self.kill or self.freeze

    def acts_on(self, port: Port[Message], listener: str) -> bool:
        """Whether this link of a port is one of the rule's."""
        if self.stops is not None or not port.signal.is_cyclic:
            return False
        if self.partition is not None:
            one, other = self.partition.split("|")
            ends = ((one, other), (other, one))
            return any(
                fnmatchcase(port.publisher, source) and fnmatchcase(listener, end)
                for source, end in ends
            )
        return (
            (self.signal is None or self.signal == port.signal.name)
            and fnmatchcase(port.publisher, self.source)
            and fnmatchcase(listener, self.listener)
        )


def _option(field: str, value: object) -> str:
    """Write a field of a rule as `--fault` reads it: `delay=50.0ms` for `delay_ms` of 50.0."""
    if field.endswith("_ms"):
        name = "reorder-by" if field == "reorder_ms" else field.removesuffix("_ms")
        return f"{name}={value}ms"
    return f"{field}={value}"


class Incident(NamedTuple):
    """Something that happens to a process at a simulated time since cycle 0 [s]."""

    time_s: float
    agent: str
    what: Literal["kill", "freeze", "thaw", "watch", "start"]


def incidents(rules: tuple[FaultRule, ...], tree: ControlTree) -> list[Incident]:
    """Return what the rules do to processes, in the order of time."""
    found = []
    for rule in rules:
        for agent in stopped_by(rule, tree):
            if rule.kill is not None:
                found.append(Incident(rule.at[0], agent, "kill"))
            else:
                found += [
                    Incident(rule.at[0], agent, "freeze"),
                    Incident(rule.at[1], agent, "thaw"),
                ]
    return sorted(found)


def stopped_by(rule: FaultRule, tree: ControlTree) -> list[str]:
    """Return the controllers that a rule kills or freezes."""
    pattern = rule.stops
    if pattern is None:
        return []
    names = [agent_name(node) for node in tree.nodes]
    return [name for name in names if fnmatchcase(name, pattern)]


@dataclass(slots=True)
class FaultTally:
    """What faults did to messages: of a lost one no copy arrived."""

    lost: int = 0
    duplicated: int = 0
    delayed: int = 0

    def count(self, fate: tuple[int, ...]) -> None:
        """Count the fate of one message."""
        self.lost += not fate
        self.duplicated += len(fate) > 1
        self.delayed += any(fate)

    def as_counts(self) -> dict[str, int]:
        """Return what was done to messages and how often, as far as it was done."""
        counts = {"lost": self.lost, "duplicated": self.duplicated, "delayed": self.delayed}
        return {name: count for name, count in counts.items() if count}


@dataclass(slots=True)
class RuleActs:
    """Messages to which a rule did something on the way to a listener, and in which cycles."""

    messages: int = 0
    first_cycle: int | None = None
    last_cycle: int | None = None

    def add(self, cycle: int) -> None:
        """Count one message; cycles may come in any order."""
        self.messages += 1
        self.first_cycle = cycle if self.first_cycle is None else min(self.first_cycle, cycle)
        self.last_cycle = cycle if self.last_cycle is None else max(self.last_cycle, cycle)


class NetworkFaults:
    """The rules of a run, at work on its links.

    Several rules on one link act as several imperfect pieces of cable, one after the other: their
    delays add, and each may lose or double whatever has come through those before it.

    Parameters
    ----------
    rules, seed
        The rules, and the seed of all that is drawn.
    tree
        Control tree of the run.
    cycle_ns
        Length of a cycle in simulated time [ns], which `silent` is stated in.
    cycle_wall_ns
        Length of a cycle on the clock that delays go by [ns]; 0 in lockstep.

    Attributes
    ----------
    acts
        What each rule has done so far.
    """

    def __init__(
        self,
        rules: tuple[FaultRule, ...],
        seed: int,
        tree: ControlTree,
        cycle_ns: int,
        cycle_wall_ns: int,
    ) -> None:
        self.acts = tuple(RuleActs() for _ in rules)
        self._links = {
            (port, listener): _Link(numbered, seed, port, listener, cycle_ns, cycle_wall_ns)
            for port, listener in links(tree)
            if (
                numbered := [
                    entry for entry in enumerate(rules) if entry[1].acts_on(port, listener)
                ]
            )
        }
        self._listeners = {listener for _, listener in self._links}

    def concern(self, listener: str) -> bool:
        """Whether any rule acts on a link to this listener."""
        return listener in self._listeners

    def most_under_way(self, listener: str) -> int:
        """Return how many messages of one port can be under way to a listener by these rules.

        That is what a publisher with one message a cycle can have sent in the longest delay, with
        all its copies. In lockstep, without a length of the cycles, it is one cycle's.
        """
        return max(
            (link.most_under_way() for (_, to), link in self._links.items() if to == listener),
            default=1,
        )

    def fates(self, port: Port[Message], listener: str, message: Message) -> tuple[int, ...]:
        """Return the delays [ns] of the copies of a message that arrive, none if it is lost.

        Arming rounds and rare events, such as the beginning and the end of a run, always pass.
        """
        link = self._links.get((port, listener))
        if link is None or message.cycle < 0:
            return UNHARMED
        return link.fate(message.cycle, self.acts)


class _Link:
    """The rules of one link: what becomes of the message of each cycle."""

    def __init__(
        self,
        rules: list[tuple[int, FaultRule]],
        seed: int,
        port: Port[Message],
        listener: str,
        cycle_ns: int,
        cycle_wall_ns: int,
    ) -> None:
        self._rules = rules
        self._stretches = [
            _Stretch(rule, f"{seed} {number} {port} {listener}") for number, rule in rules
        ]
        spans = [span for _, rule in rules for span in rule.spans]
        self._begin_s = min((begin_s for begin_s, _ in spans), default=0.0)
        self._end_s = max((end_s for _, end_s in spans), default=0.0)
        self._cycle_s = cycle_ns / 1e9
        self._cycle_wall_s = cycle_wall_ns / 1e9

    def fate(self, cycle: int, acts: Sequence[RuleActs]) -> tuple[int, ...]:
        """Return the delays [ns] of the copies that arrive; note which rules did something."""
        time_s = cycle * self._cycle_s
        if not self._begin_s <= time_s < self._end_s:
            return UNHARMED
        active = [
            (number, stretch)
            for (number, rule), stretch in zip(self._rules, self._stretches, strict=True)
            if rule.acts_outside_silence and rule.is_active(time_s)
        ]
        silent = [number for number, rule in self._rules if rule.is_silent(time_s)]
        for number in silent:
            acts[number].add(cycle)
        if silent:
            return _LOST
        delays_ms = [0.0]
        for number, stretch in active:
            before_ms = delays_ms
            delays_ms = stretch.pass_on(cycle, before_ms)
            if delays_ms != before_ms:
                acts[number].add(cycle)
        return tuple(round(delay_ms * 1e6) for delay_ms in delays_ms)

    def most_under_way(self) -> int:
        """Return how many messages the link can hold, copies and all."""
        longest_s = sum(rule.longest_ms for _, rule in self._rules) / 1e3
        cycles = ceil(longest_s / self._cycle_wall_s) + 1 if self._cycle_wall_s else 1
        doublers = sum(rule.duplicate > 0.0 for _, rule in self._rules)
        return cycles << doublers


@dataclass(slots=True)
class _Draw:
    """What one rule does to one copy of a message."""

    lost: bool
    duplicated: bool
    delay_ms: float


class _Stretch:
    """One rule on one link. Its draws are words of a hash, so they need no memory of each other."""

    def __init__(self, rule: FaultRule, name: str) -> None:
        self._rule = rule
        self._hash = blake2b(name.encode())

    def pass_on(self, cycle: int, delays_ms: list[float]) -> list[float]:
        """Return the delays [ms] of the copies that come out, given those of the ones that go in.

        A doubled copy and its double each have a loss and a delay of their own.
        """
        draws = [self._draw(cycle, copy) for copy in range(len(delays_ms))]
        doubled = [
            delay_ms for delay_ms, draw in zip(delays_ms, draws, strict=True) if draw.duplicated
        ]
        draws += [self._draw(cycle, len(draws) + copy) for copy in range(len(doubled))]
        return [
            delay_ms + draw.delay_ms
            for delay_ms, draw in zip(delays_ms + doubled, draws, strict=True)
            if not draw.lost
        ]

    def _draw(self, cycle: int, copy: int) -> _Draw:
        """Draw what becomes of a copy of the message of a cycle."""
        rule = self._rule
        digest = self._hash.copy()
        digest.update(_NUMBERS.pack(cycle, copy))
        words = _WORDS.unpack(digest.digest())
        # Of each word the 53 bits that a float holds: a number in [0, 1).
        loss, duplicate, reorder, one, other = [(word >> 11) * 2.0**-53 for word in words[:5]]
        delay_ms = max(rule.delay_ms + self._jitter_ms(one, other), 0.0)
        if reorder < rule.reorder:
            delay_ms += rule.held_back_ms
        return _Draw(loss < rule.loss, duplicate < rule.duplicate, delay_ms)

    def _jitter_ms(self, one: float, other: float) -> float:
        """Return what a message takes longer than the others, from two numbers in [0, 1)."""
        rule = self._rule
        if rule.jitter_ms == 0.0 or rule.distribution == "fixed":
            return 0.0
        if rule.distribution == "uniform":
            return rule.jitter_ms * (2.0 * one - 1.0)
        # Box and Muller (1958), doi 10.1214/aoms/1177706645.
        return rule.jitter_ms * sqrt(-2.0 * log(1.0 - one)) * cos(2.0 * pi * other)


_NUMBERS: Final = struct.Struct("<qq")
_WORDS: Final = struct.Struct("<8Q")


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

    Parameters
    ----------
    rule, tree
        The rule, and the control tree of the run.
    where
        What the user calls it.
    external
        Agents whose programs are not Heliarch's: nothing can be done to what comes in there.
    addresses
        Where the agents are that run on other hosts: their processes cannot be stopped from here.

    Raises
    ------
    InputError
        Fields that contradict each other, or a rule that does nothing; an agent or a signal that
        the run does not have, or agents that never talk to each other.
    """
    _check_fields(rule, where)
    if rule.partition is not None and rule.partition.count("|") != 1:
        raise InputError(
            f"{where}: partition: expected two agents such as c1|central, got {rule.partition}"
        )
    if rule.stops is not None:
        _check_stopped(rule, tree, where, external, addresses)
        return
    _check_ends(rule, tree, where)
    heard_by = [listener for port, listener in links(tree) if rule.acts_on(port, listener)]
    if heard_by and all(listener in external for listener in heard_by):
        raise InputError(
            f"{where}: expected a listener that Heliarch runs, where faults act, got external "
            f"agents alone ({', '.join(dict.fromkeys(heard_by))})"
        )


def _check_fields(rule: FaultRule, where: str) -> None:
    """Check what the bounds of the fields do not say."""
    if rule.distribution == "fixed" and rule.jitter_ms:
        raise InputError(
            f"{where}: distribution: expected uniform or normal with jitter, got fixed"
        )
    if rule.reorder and not rule.held_back_ms:
        raise InputError(f"{where}: reorder_ms: expected a time above 0 with reorder, got none")
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
    foreign = [name for name in found if name in external]
    if foreign:
        raise InputError(
            f"{where}: expected controllers that Heliarch runs, got the external {foreign[0]}"
        )
    away = [name for name in found if name in addresses]
    if away:
        raise InputError(
            f"{where}: expected controllers on this host, got {away[0]} on {addresses[away[0]]}"
        )


def _check_ends(rule: FaultRule, tree: ControlTree, where: str) -> None:
    agents = [agent for agent in tree.agents() if agent != RECORDER]
    ends = [("source", rule.source), ("listener", rule.listener)]
    if rule.partition is not None:
        ends = [("partition", end) for end in rule.partition.split("|")]
    for end, pattern in ends:
        if pattern == RECORDER:
            raise InputError(
                f"{where}: {end}: expected an agent that acts ({some_of(agents)}), got recorder, "
                "which hears everything"
            )
        if not any(fnmatchcase(agent, pattern) for agent in agents):
            raise InputError(
                f"{where}: {end}: expected {some_of(agents)}, or a pattern such as c1/*, got "
                f"{pattern!r}"
            )
    if rule.signal in UNHEARD:
        return
    found = links(tree)
    names = dict.fromkeys(port.signal.name for port, _ in found)
    if rule.signal in {row.name for row in SIGNALS if row.is_cyclic} - names.keys():
        return  # No agent acts on it, so that losing it costs nothing.
    if rule.signal is not None and rule.signal not in names:
        kind = "not cyclic" if rule.signal in {row.name for row in SIGNALS} else "not known"
        raise InputError(
            f"{where}: signal: expected {', '.join(names)}, got {rule.signal!r}, which is {kind}"
        )
    if not any(rule.acts_on(port, listener) for port, listener in found):
        instead = dict.fromkeys(
            f"{port.signal.name} to {listener}"
            for port, listener in found
            if fnmatchcase(port.publisher, rule.source)
        )
        raise InputError(
            f"{where}: expected one of {some_of(list(instead))}, got {rule.signal or 'anything'} "
            f"from {rule.source} to {rule.listener}, which is never sent"
            if rule.partition is None
            else f"{where}: partition: expected agents that hear each other, got {rule.partition}"
        )
