"""What the faults of a run do to each message, and how often.

A hash of seed, rule, link and cycle alone decides it, so a message has the same fate over
processes, in memory, and when the run is repeated.
"""

from __future__ import annotations

import struct
from collections import Counter
from hashlib import blake2b
from math import cos, log, pi, sqrt
from typing import Final

import msgspec

from bus_schemas.faults import FaultRule, links
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from bus_schemas.tree import ControlTree

UNHARMED: Final[tuple[int, ...]] = (0,)
"""Fate of a message that one copy of arrives at once."""


class FaultTally(Counter[str]):
    """What faults did to messages: of a lost one no copy arrived."""

    def count(self, fate: tuple[int, ...]) -> None:
        self["lost"] += not fate
        self["duplicated"] += len(fate) > 1
        self["delayed"] += any(fate)


class FaultAct(msgspec.Struct):
    """How many messages a rule acted on, once for each listener, and in which cycles."""

    rule: FaultRule
    messages: int = 0
    first_cycle: int | None = None
    last_cycle: int | None = None

    def add(self, cycle: int) -> None:
        self.messages += 1
        self.first_cycle = cycle if self.first_cycle is None else min(self.first_cycle, cycle)
        self.last_cycle = cycle if self.last_cycle is None else max(self.last_cycle, cycle)


class NetworkFaults:
    """The rules of a run, at work on its links.

    Several rules on one link act one after the other: their delays add, and each may lose or double
    whatever has come through those before it.

    cycle_ns: Length of a cycle in simulated time [ns].
    acts: What each rule has done so far.
    """

    def __init__(
        self, rules: tuple[FaultRule, ...], seed: int, tree: ControlTree, cycle_ns: int
    ) -> None:
        self.acts = tuple(map(FaultAct, rules))
        self._cycle_s = cycle_ns / 1e9
        self._rules_on: dict[tuple[Port[Message], str], list[_RuleOnLink]] = {}
        for port, listener in links(tree):
            for number, rule in enumerate(rules):
                if rule.acts_on(port, listener):
                    one = _RuleOnLink(self.acts[number], f"{seed} {number} {port} {listener}")
                    self._rules_on.setdefault((port, listener), []).append(one)
        self._listeners = {listener for _, listener in self._rules_on}

    def concern(self, listener: str) -> bool:
        return listener in self._listeners

    def fates(self, port: Port[Message], listener: str, message: Message) -> tuple[int, ...]:
        """Return the delays [ns] of the copies of a message that arrive, none if it is lost.

        Arming rounds and rare events, such as the beginning and the end of a run, always pass.
        """
        rules, cycle = self._rules_on.get((port, listener)), message.cycle
        if rules is None or cycle < 0:
            return UNHARMED
        time_s = cycle * self._cycle_s
        silent = [each for each in rules if each.rule.is_silent(time_s)]
        for each in silent:
            each.act.add(cycle)
        if silent:
            return ()
        delays_ms = [0.0]
        for each in rules:
            if each.rule.acts_outside_silence and each.rule.is_active(time_s):
                before_ms = delays_ms
                delays_ms = each.pass_on(cycle, before_ms)
                if delays_ms != before_ms:
                    each.act.add(cycle)
        return tuple(round(delay_ms * 1e6) for delay_ms in delays_ms)


class _RuleOnLink:
    """One rule on one link. Its draws are words of a hash, so they need no memory of each other."""

    def __init__(self, act: FaultAct, seed_text: str) -> None:
        self.rule = act.rule
        self.act = act
        self._hash = blake2b(seed_text.encode())

    def pass_on(self, cycle: int, delays_ms: list[float]) -> list[float]:
        """Return the delays [ms] of the copies that come out, from those of the ones that go in."""
        going_in = list(delays_ms)
        coming_out: list[float] = []
        for copy, delay_ms in enumerate(going_in):  # It grows by the doubles.
            loss, duplicate, reorder, one, other = self._draw(cycle, copy)
            if copy < len(delays_ms) and duplicate < self.rule.duplicate:
                going_in.append(delay_ms)
            if loss < self.rule.loss:
                continue
            own_ms = max(self.rule.delay_ms + self._jitter_ms(one, other), 0.0)
            if reorder < self.rule.reorder:
                own_ms += self.rule.held_back_ms
            coming_out.append(delay_ms + own_ms)
        return coming_out

    def _draw(self, cycle: int, copy: int) -> list[float]:
        """Draw five numbers in [0, 1) for a copy of the message of a cycle."""
        digest = self._hash.copy()
        digest.update(_NUMBERS.pack(cycle, copy))
        # Of each word the 53 bits that a float holds.
        return [(word >> 11) * 2.0**-53 for word in _WORDS.unpack(digest.digest())[:5]]

    def _jitter_ms(self, one: float, other: float) -> float:
        rule = self.rule
        if rule.jitter_ms == 0.0 or rule.distribution == "fixed":
            return 0.0
        if rule.distribution == "uniform":
            return rule.jitter_ms * (2.0 * one - 1.0)
        # Box and Muller (1958), doi 10.1214/aoms/1177706645.
        return rule.jitter_ms * sqrt(-2.0 * log(1.0 - one)) * cos(2.0 * pi * other)


_NUMBERS: Final = struct.Struct("<qq")
_WORDS: Final = struct.Struct("<8Q")
