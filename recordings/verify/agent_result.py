"""The result of running one agent again: what was compared, and each difference."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from bus_schemas.messages import Message
from bus_schemas.signals import Port
from recordings.verify.equality import Equality, FieldDifference

KINDS: Final = {
    "differs": "differs",
    "only recorded": "recorded, but not sent any more",
    "only new": "sent now, but not recorded",
    "sent twice": "recorded twice in one cycle: a second program sends it, too",
    "not recorded": "the recording lost messages before this one",
    "input not recorded": "used, but not recorded",
    "fails": "raises an error, or sends what cannot be sent",
}
"""How new messages can differ from the recorded ones."""

LOSSES: Final = frozenset({"only new", "not recorded", "input not recorded"})
"""What shows that the recording lacks messages, and no agent decides otherwise."""


@dataclass(frozen=True, slots=True)
class Difference:
    """One difference between the recording and what the agent does now.

    `message` is the key of the message that differs, or of the input that is not recorded;
    `content` the recorded message if there is one, else the new one; `inputs` what the agent
    received in that cycle, by key; `text` the error of an agent that fails.
    """

    kind: str
    cycle: int
    stage: str
    message: str = ""
    fields: tuple[FieldDifference, ...] = ()
    content: Message | None = None
    inputs: dict[str, Message] = field(default_factory=dict)
    text: str = ""


@dataclass(slots=True)
class AgentResult:
    """The result of running one agent again, from `from_cycle` to its failure, if it fails.

    It counts messages in the recording, pairs that were compared, and differences by kind.
    """

    recorded: int = 0
    compared: int = 0
    differences: Counter[str] = field(default_factory=Counter)
    first: Difference | None = None
    last_cycle: int = -1
    failure: Difference | None = None
    not_compared: int = 0
    from_cycle: int = 0

    def compare(
        self,
        equality: Equality,
        port: Port[Message],
        recorded: Message | None,
        new: Message | None,
        stage: str,
        inputs: Mapping[Port[Message], Message] | None = None,
    ) -> None:
        message = recorded or new
        if message is None or message.cycle < self.from_cycle:
            return
        fields: tuple[FieldDifference, ...] = ()
        kind = "only new" if recorded is None else "only recorded"
        if recorded is not None and new is not None:
            fields = equality.differences(port, recorded, new)
            self.compared += 1
            if not fields:
                return
            kind = "differs"
        used = {str(port): message for port, message in (inputs or {}).items()}
        self.add(Difference(kind, message.cycle, stage, str(port), fields, message, used))

    def add(self, difference: Difference) -> None:
        """Count a difference, and keep it if it is the first."""
        self.differences[difference.kind] += 1
        self.last_cycle = max(self.last_cycle, difference.cycle)
        if difference.kind == "fails":
            self.failure = difference
        if self.first is None or difference.cycle < self.first.cycle:
            self.first = difference
