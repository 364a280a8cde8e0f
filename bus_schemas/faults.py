"""Faults of links: what delays, loses, duplicates or cuts off messages.

A link goes from the publisher of a port to one of its listeners. The recorder hears everything: a
recording says what was sent, and `missing` in its messages what did not arrive.

The words are those of network emulation in Linux, tc-netem(8), but `reorder` holds a share of the
messages back, so that later ones overtake it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from fnmatch import fnmatchcase
from typing import Annotated, ClassVar, Final, Literal, TypeAlias

import msgspec
from msgspec import Meta

from bus_schemas.errors import InputError, listed
from bus_schemas.messages import Message
from bus_schemas.signals import SIGNALS, Port, listeners, ports
from bus_schemas.tree import RECORDER, ControlTree

UNHEARD: Final = frozenset(
    signal.name for signal in SIGNALS if signal.is_cyclic and not signal.listeners
)
"""Cyclic signals that no agent acts on: what becomes of them changes nothing in a run."""

Probability: TypeAlias = Annotated[float, Meta(ge=0.0, le=1.0)]
Milliseconds: TypeAlias = Annotated[float, Meta(ge=0.0, le=3_600_000.0)]
Second: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e12)]
Interval: TypeAlias = tuple[Second, Second]


class Rule(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind"):
    """A fault. `at`: When it acts, a time, or beginning and end."""

    def __post_init__(self) -> None:
        at = getattr(self, "at", None)
        if isinstance(at, tuple) and at[0] >= at[1]:
            expected = f"an end after the beginning {at[0]:g} s"
            raise InputError.of("at", f"expected {expected}, got {at[1]:g} s")

    @property
    def begin_s(self) -> float:
        at: Interval | float | None = getattr(self, "at", None)
        return at[0] if isinstance(at, tuple) else at or 0.0


class _OneWay(Rule, frozen=True, kw_only=True):
    """A fault of links in one direction.

    source: Publishing agent: `plant`, `c2/inv07`, or a pattern such as `c1/*`.
    listener: Receiving agent, in the same form.
    signal: Name of a cyclic signal. Default: any.
    """

    source: str = "*"
    listener: str = "*"
    signal: str | None = None


class Disturbance(_OneWay, frozen=True, kw_only=True, tag="disturbance"):
    """Messages come late, twice, in another order, or not at all.

    delay_ms: Delay of each message [ms].
    jitter_ms: Spread of the delay [ms], which is never below 0.
    distribution: `jitter_ms` is the range (±), or the standard deviation if `normal`.
    loss: Share of messages that do not arrive.
    duplicate: Share that arrives twice; the copy has its own delay and loss.
    reorder: Share that is held back, so that later messages overtake it.
    reorder_ms: Extra delay when held back [ms]. Default: one more `delay_ms`.
    at: Beginning and end, since cycle 0 [s]. Default: always.
    """

    delay_ms: Milliseconds = 0.0
    jitter_ms: Milliseconds = 0.0
    distribution: Literal["uniform", "normal"] = "uniform"
    loss: Probability = 0.0
    duplicate: Probability = 0.0
    reorder: Probability = 0.0
    reorder_ms: Milliseconds | None = None
    at: Interval | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.reorder and not self.held_back_ms:
            expected = "a delay or reorder-by (reorder_ms) above 0 with it"
            raise InputError.of("reorder", f"expected {expected}, got none")
        if not any((self.delay_ms, self.jitter_ms, self.loss, self.duplicate, self.reorder)):
            raise InputError("expected a delay, loss, kill or other fault, got none")

    @property
    def held_back_ms(self) -> float:
        return self.delay_ms if self.reorder_ms is None else self.reorder_ms


class Blackout(_OneWay, frozen=True, kw_only=True, tag="blackout"):
    """Nothing arrives.

    at: Beginning and end, since cycle 0 [s].
    """

    at: Interval


class Partition(Rule, frozen=True, tag="partition"):
    """Two agents do not hear each other.

    between: Agents, or patterns of them: `["c1", "central"]`.
    at: Beginning and end, since cycle 0 [s]. Default: always.
    """

    between: tuple[str, str]
    at: Interval | None = None
    signal: ClassVar[None] = None


LinkFault: TypeAlias = Disturbance | Blackout | Partition


def acts_on(fault: LinkFault, port: Port[Message], listener: str) -> bool:
    if isinstance(fault, Partition):
        one, other = fault.between
        ends = [(one, other), (other, one)]
    else:
        ends = [(fault.source, fault.listener)]
    return fault.signal in {None, port.signal.name} and any(
        fnmatchcase(port.publisher, source) and fnmatchcase(listener, heard_by)
        for source, heard_by in ends
    )


def links(tree: ControlTree) -> list[tuple[Port[Message], str]]:
    return [
        (port, listener)
        for port in ports(tree)
        if port.signal.is_cyclic
        for listener in listeners(port, tree)
    ]


def link_objections(
    fault: LinkFault, tree: ControlTree, external: Collection[str]
) -> Iterator[str]:
    """Yield why a fault does not fit a run.

    external: Agents that Heliarch does not run: faults cannot act on their inputs.
    """
    signal = fault.signal
    if isinstance(fault, Partition):
        patterns = [("between", pattern) for pattern in fault.between]
    else:
        patterns = [("source", fault.source), ("listener", fault.listener)]
    agents = [agent for agent in tree.agents() if agent != RECORDER]
    for field, pattern in patterns:
        if not any(fnmatchcase(agent, pattern) for agent in agents):
            known = f"{listed(agents)}, or a pattern such as c1/*"
            yield f"{field}: expected {known}, got {pattern!r}"
    if signal in UNHEARD:
        return  # No agent acts on it, so losing it costs nothing.
    every = links(tree)
    names = dict.fromkeys(port.signal.name for port, _ in every)
    if signal is not None and signal not in names:
        yield f"signal: expected {', '.join(names)}, got {signal!r}"
    heard_by = {listener for port, listener in every if acts_on(fault, port, listener)}
    if not heard_by:
        got = " and ".join(pattern for _, pattern in patterns)
        yield f"expected agents of which one hears the other, got {got}"
    if heard_by <= set(external):
        yield f"expected a listener that Heliarch runs, got only {', '.join(sorted(heard_by))}"
