"""What the comparison of one agent came to: its differences, and what could not be compared."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from launch_scripts.verification.comparison import FieldDifference

Kind: TypeAlias = Literal[
    "differs",
    "only recorded",
    "only new",
    "other order",
    "recorded twice",
    "input not recorded",
    "fails",
]
"""`differs`: in its fields. `only recorded`: the agent does not say it now. `only new`: the
recording lacks it. `other order`: it says the same of a cycle in another order. `recorded twice`:
in one cycle. `input not recorded`: the agent must have heard something that the recording lacks.
`fails`: the agent raises an error, or says what cannot be sent."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A recorded message that the agent does not send now, or the other way round.

    Attributes
    ----------
    kind
        In what they differ.
    cycle
        Number of the cycle.
    stage
        The agent's stage that sends the message, empty if none does.
    port
        What the message is about; of `input not recorded` the input.
    fields
        Fields that differ, of kind `differs`.
    message
        The message in question: the recorded one if there is one, else the new one.
    inputs
        What the agent was given in that cycle.
    missing
        What it had to do without, and what took its place, see `bus_schemas.missing`.
    text
        What went wrong, of kind `fails`; both orders, of kind `other order`.
    """

    kind: Kind
    cycle: int
    stage: str
    port: Port[Message] | None
    fields: tuple[FieldDifference, ...] = ()
    message: Message | None = None
    inputs: tuple[Delivery, ...] = ()
    missing: tuple[str, ...] = ()
    text: str = ""


@dataclass(slots=True)
class Gap:
    """Cycles in which an agent's messages were not compared.

    Attributes
    ----------
    from_cycle, to_cycle
        The first and the last one with a message that was not compared.
    messages
        How many there are.
    open
        Whether nothing was compared after it either.
    """

    from_cycle: int
    to_cycle: int
    messages: int = 0
    open: bool = True


@dataclass(slots=True)
class Account:
    """What the comparison of one agent came to.

    Attributes
    ----------
    recorded
        Its messages in the recording.
    compared
        Pairs of messages that were held against each other.
    missed_inputs
        Inputs that were not there in time.
    late_used
        Late words that it used, most of them in their place.
    counts
        Differences by kind.
    first
        The first of them.
    failure
        The error that the agent raised, if any: after it nothing is compared.
    gaps
        Where messages were not compared, because nobody knows the agent's state.
    """

    recorded: int = 0
    compared: int = 0
    missed_inputs: int = 0
    late_used: int = 0
    counts: Counter[Kind] = field(default_factory=Counter)
    first: Difference | None = None
    failure: Difference | None = None
    gaps: list[Gap] = field(default_factory=list)

    @property
    def not_compared(self) -> int:
        """Recorded messages of which nobody knows whether the agent would send them now."""
        return sum(gap.messages for gap in self.gaps)

    @property
    def not_compared_from(self) -> int | None:
        """The first cycle with such a message, None if there is none."""
        return self.gaps[0].from_cycle if self.gaps else None

    def add(self, difference: Difference) -> None:
        """Count a difference, and keep it if it is the first."""
        self.counts[difference.kind] += 1
        if difference.kind == "fails":
            self.failure = difference
        self._keep_first(difference)

    def absorb(self, later: Account) -> None:
        """Add what was not certain when it was found."""
        self.counts.update(later.counts)
        if later.first is not None:
            self._keep_first(later.first)

    def leave_out(self, cycle: int, messages: int) -> None:
        """Count messages of a cycle that are not compared."""
        if not messages:
            return
        if not self.gaps or not self.gaps[-1].open:
            self.gaps.append(Gap(cycle, cycle))
        self.gaps[-1].to_cycle = cycle
        self.gaps[-1].messages += messages

    def resume(self) -> None:
        """Note that from the next cycle on messages are compared again."""
        if self.gaps:
            self.gaps[-1].open = False

    def _keep_first(self, difference: Difference) -> None:
        if self.first is None or difference.cycle < self.first.cycle:
            self.first = difference
