"""What the comparison of one agent found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias

from bus_schemas.messages import Message
from bus_schemas.signals import Port
from recordings.verify.comparison import Comparison, FieldDifference

Kind: TypeAlias = Literal[
    "differs",
    "only recorded",
    "only new",
    "recorded twice",
    "not recorded",
    "input not recorded",
    "fails",
]

KINDS: Final[dict[Kind, str]] = {
    "differs": "differs",
    "only recorded": "recorded, but not sent any more",
    "only new": "sent now, but not recorded",
    "recorded twice": "recorded twice in one cycle",
    "not recorded": "the recording lost messages before this one",
    "input not recorded": "used, but not recorded",
    "fails": "raises an error, or sends what cannot be sent",
}
"""How new messages can differ from the recorded ones, in words."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One difference between the recording and what the agent does now.

    Attributes
    ----------
    message
        Key of the message that differs; of `input not recorded` that of the input.
    fields
        Fields that differ.
    content
        The recorded message if there is one, else the new one.
    inputs
        What the agent received in that cycle, by key.
    missing
        The inputs that were not of that cycle, see `bus_schemas.missing`.
    text
        The error, if the agent fails.
    """

    kind: Kind
    cycle: int
    stage: str
    message: str = ""
    fields: tuple[FieldDifference, ...] = ()
    content: Message | None = None
    inputs: dict[str, Message] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    text: str = ""


@dataclass(slots=True)
class Findings:
    """What the comparison of one agent found.

    Attributes
    ----------
    recorded, compared
        Its messages in the recording, and the pairs that were compared.
    missing_inputs, old_inputs
        Inputs that were missing at a deadline, and older ones that were used.
    differences
        Their number by kind.
    first
        The first of them.
    failure
        The error of the agent, if there was one: nothing is compared after it.
    not_compared, not_compared_from
        Recorded messages that could not be compared, and the cycle of the first one.
    """

    recorded: int = 0
    compared: int = 0
    missing_inputs: int = 0
    old_inputs: int = 0
    differences: Counter[Kind] = field(default_factory=Counter)
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
        inputs: Mapping[Port[Message], Message] | None = None,
    ) -> None:
        """Compare a recorded message with a new one; either may be None."""
        fields: tuple[FieldDifference, ...] = ()
        kind: Kind = "only new" if recorded is None else "only recorded"
        if recorded is not None and new is not None:
            fields = comparison.differences(port, recorded, new)
            self.compared += 1
            if not fields:
                return
            kind = "differs"
        message = recorded or new
        assert message is not None
        self.add(
            Difference(
                kind,
                message.cycle,
                stage,
                str(port),
                fields,
                message,
                by_key(inputs or {}),
                message.missing,
            )
        )

    def add(self, difference: Difference) -> None:
        """Count a difference, and keep it if it is the first."""
        self.differences[difference.kind] += 1
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


def by_key(messages: Mapping[Port[Message], Message]) -> dict[str, Message]:
    """Return messages by their keys."""
    return {str(port): message for port, message in messages.items()}
