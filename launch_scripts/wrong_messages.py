"""Messages that could not be used, by key and cause: what recorder and listeners say of them.

The recorder hears everything, but does not take part in cycles; an agent hears its own keys alone,
and knows what came too late. Both may have complained of the same message: the larger count holds.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Final

import msgspec

from agents.events import Complaint
from agents.plan import RunPlan
from bus_schemas.signals import ports

_LISTENERS_CAUSES: Final = {
    "late": "of a cycle that was over",
    "other_cycle": "of a cycle far from this one",
    "unexpected": "not expected in its cycle",
    "duplicate": "came twice in a cycle",
    "foreign": "not from who may publish there",
    "flooded": "more than can be looked at",
}
"""What agents' words for a cause mean."""


class WrongMessages(msgspec.Struct, frozen=True):
    """Messages of one key that were wrong in one way, with what is to be said of the first one."""

    key: str
    cause: str
    count: int
    example: str


def wrong_messages(
    plan: RunPlan,
    complaints: Iterable[Complaint],
    dropped_ports: Iterable[Mapping[str, Mapping[str, int]]],
) -> tuple[WrongMessages, ...]:
    """Bring together what was complained of, those keys first of which it was most.

    Parameters
    ----------
    plan
        Of the run. Keys are told without the plant's name.
    complaints
        The recorder's.
    dropped_ports
        The agents', each by port and cause. Those of external agents' ports count here: what comes
        late from processes is the machine's doing.
    """
    theirs = {str(port) for port in ports(plan.tree) if port.publisher in plan.external}
    counts: Counter[tuple[str, str]] = Counter()
    for dropped in dropped_ports:
        for port in theirs.intersection(dropped):
            for cause, count in dropped[port].items():
                counts[port, cause] += count
    examples = {place: _LISTENERS_CAUSES.get(place[1], "") for place in counts}
    for complaint in complaints:
        place = (complaint.key.removeprefix(f"{plan.plant}/"), complaint.cause)
        counts[place] = max(counts[place], complaint.count)
        examples[place] = complaint.example
    return tuple(
        WrongMessages(key, cause, count, examples[key, cause])
        for (key, cause), count in counts.most_common()
    )
