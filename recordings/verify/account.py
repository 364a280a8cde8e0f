"""What the comparison of one agent came to: its differences, and what could not be compared."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from recordings.verify.comparison import Comparison, FieldDifference

Kind: TypeAlias = Literal[
    "differs",
    "two messages in one cycle",
    "only recorded",
    "only new",
    "recorded twice",
    "not recorded",
    "input not recorded",
    "fails",
]
"""How a recorded and a new message differ.

- `differs`: in its fields
- `two messages in one cycle`: the same, but an external agent sent several messages in one cycle,
  and the agent may have used another than the first recorded one
- `only recorded`: the agent does not send it now
- `only new`: the recording lacks it
- `recorded twice`: in one cycle
- `not recorded`: its number shows that the recording lost messages before it
- `input not recorded`: the agent used a message that the recording lacks
- `fails`: the agent raises an error, or sends what cannot be sent
"""


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
        The agent's stage that sends the message, empty if it is not known.
    port
        What the message is about; of `input not recorded` the input.
    fields
        Fields that differ.
    message
        The message in question: the recorded one if there is one, else the new one.
    inputs
        What the agent was given in that cycle.
    missing
        The inputs that were not of that cycle, see `bus_schemas.missing`.
    text
        What went wrong, of kind `fails`.
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
class Account:
    """What the comparison of one agent came to.

    Attributes
    ----------
    recorded
        Its messages in the recording.
    compared
        Pairs of messages that were compared.
    missing_inputs, old_inputs
        Awaited inputs that a deadline found missing, and older ones that were used.
    counts
        Differences by kind.
    first
        The first of them.
    failure
        The error that the agent raised, if any: after it nothing is compared.
    not_compared
        Recorded messages of which nobody knows whether the agent would send them now.
    not_compared_from
        The first cycle with such a message, None if there is none.
    """

    recorded: int = 0
    compared: int = 0
    missing_inputs: int = 0
    old_inputs: int = 0
    counts: Counter[Kind] = field(default_factory=Counter)
    first: Difference | None = None
    failure: Difference | None = None
    not_compared: int = 0
    not_compared_from: int | None = None

    def compare(
        self,
        comparison: Comparison,
        port: Port[Message],
        recorded: Message | None,
        new: Message | None,
        stage: str,
        inputs: Sequence[Delivery] = (),
        *,
        ambiguous: bool = False,
    ) -> None:
        """Compare a recorded message with a new one; either may be None.

        Parameters
        ----------
        ambiguous
            Whether an input was sent twice in its cycle.

        Raises
        ------
        Unsendable
            The new message could not be sent.
        """
        message = new if recorded is None else recorded
        assert message is not None
        kind: Kind = "only new" if recorded is None else "only recorded"
        fields: tuple[FieldDifference, ...] = ()
        if recorded is not None and new is not None:
            self.compared += 1
            fields = comparison.differences(port, recorded, new)
            if not fields:
                return
            kind = "two messages in one cycle" if ambiguous else "differs"
        self.add(
            Difference(
                kind, message.cycle, stage, port, fields, message, tuple(inputs), message.missing
            )
        )

    def add(self, difference: Difference) -> None:
        """Count a difference, and keep it if it is the first."""
        self.counts[difference.kind] += 1
        if difference.kind == "fails":
            self.failure = difference
        if self.first is None or difference.cycle < self.first.cycle:
            self.first = difference

    def leave_out(self, cycle: int, messages: int) -> None:
        """Count messages of a cycle that are not compared."""
        if messages:
            self.not_compared += messages
            if self.not_compared_from is None:
                self.not_compared_from = cycle
