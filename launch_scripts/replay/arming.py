"""The barrier before a live replay: every live agent is there and a round of theirs has closed."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Iterator
from typing import Final

from msgspec.structs import replace

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.codec import decode
from bus_schemas.messages import Message, Residual
from bus_schemas.signals import HELP, Port
from launch_scripts.interruption import Interruption
from launch_scripts.replay.stand_in import StandIn, steady_ports
from launch_scripts.replay.tape import Tape
from launch_scripts.supervision import Children, RunFailure
from recordings.reader import RecordedMessage
from sim_plant.conductor import FIRST_ROUND, longest_round_s

_ARMING_S: Final = 30.0

_MOMENT_S: Final = 0.1
"""How long to wait for answers before looking at the processes and the keyboard."""

_EARLY_CYCLES: Final = 100
"""In so many first cycles everybody has spoken, even where messages got lost."""


def arm(
    tape: Tape,
    plan: RunPlan,
    live: Collection[str],
    stand_in: StandIn,
    children: Children,
    interruption: Interruption,
) -> int:
    """Wait for the live agents, and for a round of theirs to close. Return the number of rounds.

    What the others say in a round is the first that they said in the run.

    Raises
    ------
    RunFailure
        A live agent does not come, or says nothing.
    KeyboardInterrupt
        The user has asked for an end.
    """
    give_up_at = time.monotonic() + _ARMING_S
    while absent := stand_in.absent():
        _look(children, interruption)
        if time.monotonic() > give_up_at:
            raise RunFailure(f"no sign of life from {', '.join(absent)}")
    records = tape.records(before_cycle=_EARLY_CYCLES)
    words = list(first_words(plan, live, records))
    steady = steady_ports(plan, live, FIRST_ROUND)
    rounds = 0
    silent: set[Port[Message]] = steady
    while time.monotonic() < give_up_at:
        rounds += 1
        silent = set(steady)
        _begin_round(FIRST_ROUND + rounds, plan, words, stand_in)
        until = time.monotonic() + longest_round_s(rounds)
        while silent and time.monotonic() < until:
            silent -= _heard_in(FIRST_ROUND + rounds, len(silent), stand_in)
            _look(children, interruption)
        if not silent:
            return rounds
    names = ", ".join(sorted(map(str, silent)))
    raise RunFailure(f"no arming round closed: nothing came on {names}")


def first_words(
    plan: RunPlan, live: Collection[str], records: Iterable[RecordedMessage]
) -> Iterator[Delivery]:
    """Yield the first message of each port on which the others must publish in a cycle.

    A residual that asks for help comes with the help that was asked for beside it.
    """
    others = set(plan.tree.agents()).difference(live)
    wanted = steady_ports(plan, others, FIRST_ROUND)
    first: dict[Port[Message], Message] = {}
    helps: dict[tuple[str, int], Message] = {}
    for record in records:
        port = record.port
        if port.signal is HELP:
            helps[port.node, record.cycle] = decode(port.signal, record.payload)
        elif port in wanted and port not in first:
            first[port] = decode(port.signal, record.payload)
    for port, message in first.items():
        yield port, message
        asked = helps.get((port.node, message.cycle))
        if isinstance(message, Residual) and message.power_kw < 0.0 and asked is not None:
            yield HELP.of(port.node), asked


def _begin_round(cycle: int, plan: RunPlan, words: Iterable[Delivery], stand_in: StandIn) -> None:
    """Send what the others say in an arming round."""
    for port, message in words:
        stamped = replace(
            message,
            cycle=cycle,
            sim_time_ns=plan.sim_time_ns(cycle),
            missing=(),
            publish_time_ns=time.monotonic_ns(),
            sequence=0,
        )
        stand_in.publish(port, stamped)


def _heard_in(cycle: int, wanted: int, stand_in: StandIn) -> set[Port[Message]]:
    """Wait a moment; return the ports on which the live agents have said something in a round."""
    heard = stand_in.receive(wanted, _MOMENT_S)
    return {arrival.port for arrival in heard if arrival.message.cycle == cycle}


def _look(children: Children, interruption: Interruption) -> None:
    children.events(0.02)
    if interruption:
        raise KeyboardInterrupt
