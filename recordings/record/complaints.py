"""What is wrong with messages on the bus: counted by key and cause, with the first example.

A publisher sends one message in a cycle, and numbers its messages upwards. A process that replaces
it has a higher incarnation, and the replaced one publishes nothing more. In lockstep a process that
is replaced in the cycle in which it joined has a successor of the same incarnation, which sends the
same messages once more.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import astuple
from typing import Final

from msgspec.structs import replace

from agents.inputs import log_drop
from agents.plan import RunPlan
from agents.process.events import Complaint
from bus_schemas.bus import Cause
from bus_schemas.codec import UNREADABLE
from bus_schemas.errors import printable
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port
from recordings.verify.comparison import Equality, FieldDifference

_RECORDED: Final = frozenset({Cause.OUT_OF_RANGE, Cause.DUPLICATE, Cause.CONFLICTING})
"""Of messages that are recorded all the same: the others are set aside."""

_MOST_KINDS: Final = 500
_MOST_UNKNOWN: Final = 5
"""Most keys and causes that are counted apart, and among them most unknown keys."""

_LONGEST: Final = 300
"""Characters of a key or an example that are kept."""


class Complaints:
    """The complaints of a run."""

    def __init__(self, tell: Callable[[Complaint], None]) -> None:
        self._tell = tell
        self._by_kind: dict[tuple[str, str], Complaint] = {}

    def add(self, key: str, cause: str, example: str) -> None:
        key, example = printable(key[:_LONGEST]), printable(example[:_LONGEST])
        if (key, cause) not in self._by_kind:
            unknown = sum(one == Cause.UNKNOWN for _, one in self._by_kind)
            is_one_more = cause == Cause.UNKNOWN and unknown >= _MOST_UNKNOWN
            if is_one_more or len(self._by_kind) >= _MOST_KINDS:
                key = "other keys"
        before = self._by_kind.get((key, cause))
        if before is None:
            complaint = Complaint(key, cause, 1, example)
            self._tell(complaint)
        else:
            complaint = replace(before, count=before.count + 1)
        self._by_kind[key, cause] = complaint
        log_drop(complaint.count, f"{key}: {example}")

    @property
    def set_aside(self) -> int:
        """Wrong messages that are not in the recording."""
        return sum(one.count for one in self._by_kind.values() if one.cause not in _RECORDED)

    def all(self) -> tuple[Complaint, ...]:
        return tuple(self._by_kind[kind] for kind in sorted(self._by_kind))


_MOST_KEPT = 4
"""Messages of a key that are kept: one of the cycle under way, and of those beside it."""

_CONTENT = Equality(ignored=frozenset({"incarnation", "missing"}))


class SecondSenders:
    """The newest messages, by cycle, and the newest incarnations of keys with one in each cycle.

    `extra` counts, by signal, second messages on keys of the launcher's own processes.
    """

    def __init__(self, plan: RunPlan) -> None:
        self.extra: Counter[str] = Counter()
        self._payloads: dict[Port[Message], dict[int, bytes]] = {
            port: {} for port in plan.wiring.ports if port.signal.is_cyclic or port.signal is RUN
        }
        self._newest = dict.fromkeys(self._payloads, 0)
        self._elsewhere = plan.elsewhere

    def hear(
        self, port: Port[Message], cycle: int, incarnation: int, payload: bytes
    ) -> tuple[str, str] | None:
        """Return cause and text of a complaint if a message contradicts earlier ones."""
        payloads = self._payloads.get(port)
        if payloads is None:
            return None
        newest = self._newest[port]
        if 0 < incarnation > cycle:
            self.note_extra(port)
            return (
                Cause.CONFLICTING,
                f"it is of cycle {cycle}, and its process joined in {incarnation}",
            )
        if incarnation < newest:
            if cycle <= newest:  # It was on its way.
                return None
            self.note_extra(port)
            joined = f"one joined in cycle {newest}, another in {incarnation}"
            return Cause.CONFLICTING, f"{joined}, and both sent after that"
        if incarnation > newest:
            self._newest[port] = incarnation
            payloads.clear()
        first = payloads.setdefault(cycle, payload)
        if first is not payload:
            self.note_extra(port)
            return _compare(port, first, payload)
        if len(payloads) > _MOST_KEPT:
            oldest = min(payloads)
            del payloads[oldest if oldest != cycle else max(payloads)]
        return None

    def note_extra(self, port: Port[Message]) -> None:
        """Count a message that another program sent."""
        if port.publisher not in self._elsewhere:
            self.extra[port.signal.name] += 1


def _compare(port: Port[Message], first: bytes, second: bytes) -> tuple[str, str]:
    """Say in what two messages of one key and cycle differ."""
    try:
        one, other = port.signal.decode(first), port.signal.decode(second)
    except UNREADABLE as error:
        return (
            Cause.CONFLICTING,
            f"two messages in one cycle, of which one does not decode: {error}",
        )
    cycle, numbers = one.cycle, FieldDifference("sequence", one.sequence, other.sequence)
    has_just_joined = 0 < cycle == one.incarnation
    differing = list(_CONTENT.differences(port, one, other))
    if first != second and numbers.new <= numbers.recorded and not has_just_joined:
        differing.append(numbers)
    if not differing:
        return Cause.DUPLICATE, f"it came again for cycle {cycle}"
    field, *both = astuple(differing[0])
    values = " and ".join(str(value)[:60] for value in both)
    return Cause.CONFLICTING, f"two messages in cycle {cycle}, {field} {values}"
