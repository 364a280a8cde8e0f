"""The faults of a run at work on its links: what becomes of each message, and how often.

It is drawn from a hash of the seed, the rule, the link and the message's cycle, and from nothing
else: not from the order in which things happen. So a message has the same fate over processes, in
memory, and when the run is repeated.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b
from math import ceil, cos, log, pi, sqrt
from typing import Final

from bus_schemas.faults import FaultRule, links
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from bus_schemas.tree import ControlTree

UNHARMED: Final[tuple[int, ...]] = (0,)
"""Fate of a message that one copy of arrives at once."""

_LOST: Final[tuple[int, ...]] = ()


@dataclass(slots=True)
class FaultTally:
    """What faults did to messages: of a lost one no copy arrived."""

    lost: int = 0
    duplicated: int = 0
    delayed: int = 0

    def count(self, fate: tuple[int, ...]) -> None:
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

    rules, seed: The rules, and the seed of all that is drawn.
    cycle_ns: Length of a cycle in simulated time [ns], which `silent` is stated in.
    cycle_wall_ns: Length of a cycle on the clock that delays go by [ns]; 0 in lockstep.

    acts: What each rule has done so far.
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
    """The effect of one rule on one copy of a message."""

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
