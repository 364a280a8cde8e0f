"""What the faults of a run do to each message.

A hash of seed, rule, link and cycle alone decides it, so a message has the same fate over
processes, in memory, and when the run is repeated.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from hashlib import blake2b
from math import cos, log, pi, sqrt
from typing import Final

from bus_schemas.faults import Disturbance, LinkFault, acts_on, links
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from bus_schemas.tree import ControlTree

UNHARMED: Final[tuple[int, ...]] = (0,)
"""Fate of a message that arrives once and without delay."""


class NetworkFaults:
    """The faults of a run's links, at work.

    Several faults on one link act one after the other: their delays add, and each may lose or
    double whatever has come through those before it.

    faults: By their numbers among all faults of the run, on which the draws depend.
    cycle_ns: Length of a cycle in simulated time [ns].
    """

    def __init__(
        self, faults: Mapping[int, LinkFault], seed: int, tree: ControlTree, cycle_ns: int
    ) -> None:
        self._cycle_s = cycle_ns / 1e9
        self._faults_on: dict[tuple[Port[Message], str], list[_FaultOnLink]] = {}
        for port, listener in links(tree) if faults else ():
            for number, fault in faults.items():
                if acts_on(fault, port, listener):
                    seed_text = f"{seed} {number} {port} {listener}"
                    one = _FaultOnLink(fault, seed_text)
                    self._faults_on.setdefault((port, listener), []).append(one)
        self._listeners = {listener for _, listener in self._faults_on}

    def concern(self, listener: str) -> bool:
        return listener in self._listeners

    def fates(self, port: Port[Message], listener: str, message: Message) -> tuple[int, ...]:
        """Return the delays [ns] of the copies of a message that arrive, none if it is lost.

        Arming rounds and rare events, such as the beginning and the end of a run, always pass.
        """
        faults, cycle = self._faults_on.get((port, listener)), message.cycle
        if faults is None or cycle < 0:
            return UNHARMED
        time_s = cycle * self._cycle_s
        delays_ms = [0.0]
        for each in faults:
            at = each.fault.at
            if at is None or at[0] <= time_s < at[1]:
                delays_ms = each.pass_on(cycle, delays_ms)
        return tuple(round(delay_ms * 1e6) for delay_ms in delays_ms)


class _FaultOnLink:
    """One fault on one link. Its draws are words of a hash."""

    def __init__(self, fault: LinkFault, seed_text: str) -> None:
        self.fault = fault
        self._hash = blake2b(seed_text.encode())

    def pass_on(self, cycle: int, delays_ms: list[float]) -> list[float]:
        """Return the delays [ms] of the copies that come out, from those of the ones that go in."""
        fault = self.fault
        if not isinstance(fault, Disturbance):
            return []
        going_in = list(delays_ms)
        coming_out: list[float] = []
        for copy, delay_ms in enumerate(going_in):  # It grows by the doubles.
            loss, duplicate, reorder, one, other = self._draw(cycle, copy)
            if copy < len(delays_ms) and duplicate < fault.duplicate:
                going_in.append(delay_ms)
            if loss < fault.loss:
                continue
            own_ms = max(fault.delay_ms + _jitter_ms(fault, one, other), 0.0)
            if reorder < fault.reorder:
                own_ms += fault.held_back_ms
            coming_out.append(delay_ms + own_ms)
        return coming_out

    def _draw(self, cycle: int, copy: int) -> list[float]:
        """Draw five numbers in [0, 1) for a copy of the message of a cycle."""
        digest = self._hash.copy()
        digest.update(_NUMBERS.pack(cycle, copy))
        # Of each word the 53 bits that a float holds.
        return [(word >> 11) * 2.0**-53 for word in _WORDS.unpack(digest.digest())[:5]]


def _jitter_ms(fault: Disturbance, one: float, other: float) -> float:
    """Return the jitter that two draws in [0, 1) stand for [ms]."""
    if fault.jitter_ms == 0.0:
        return 0.0
    if fault.distribution == "uniform":
        return fault.jitter_ms * (2.0 * one - 1.0)
    # Box and Muller (1958), doi 10.1214/aoms/1177706645.
    return fault.jitter_ms * sqrt(-2.0 * log(1.0 - one)) * cos(2.0 * pi * other)


_NUMBERS: Final = struct.Struct("<qq")
_WORDS: Final = struct.Struct("<8Q")
