"""Messages that could not be used, by key and cause: what recorder and listeners say of them.

The recorder hears everything, but takes no part in cycles. An agent hears only its own keys, and
knows what came too late. Both may have counted the same message: the larger count holds.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Final

from msgspec.structs import replace

from agents.events import Complaint
from agents.plan import RunPlan
from recordings.inspect.health import WrongMessages

_LISTENERS_CAUSES: Final = {
    "late": "older than the newest one",
    "other_cycle": "of a cycle far from this one",
    "unexpected": "not of a turn of its sender",
    "duplicate": "came twice in a cycle",
    "foreign": "not from who may publish there",
    "flooded": "more than can be looked at",
    "contradicted": "contradicts what the publisher goes on saying",
}
"""Texts for the causes that agents name."""


def wrong_messages(
    plan: RunPlan,
    complaints: Iterable[Complaint],
    dropped: Iterable[tuple[str, str, int]],
) -> tuple[WrongMessages, ...]:
    """Return the wrong messages of a run by key and cause, the most frequent first.

    complaints: Those of the recorder; the plant's name is left out of their keys.
    dropped: What agents dropped: port, cause and number. Only ports of external agents count: a
        late message of a process is the machine's fault.
    """
    publishers = {str(port): port.publisher for port in plan.wiring.ports}
    theirs = {port for port, publisher in publishers.items() if publisher in plan.external}
    counts: Counter[tuple[str, str]] = Counter()
    for port, cause, count in dropped:
        if port in theirs:
            counts[port, cause] += count
    examples = {place: _LISTENERS_CAUSES.get(place[1], "") for place in counts}
    for complaint in complaints:
        place = (complaint.key.removeprefix(f"{plan.plant}/"), complaint.cause)
        counts[place] = max(counts[place], complaint.count)
        examples[place] = complaint.example
    return tuple(
        WrongMessages(key, cause, count, examples[key, cause], publishers.get(key, ""))
        for (key, cause), count in counts.most_common()
    )


def one_line_each(wrong: Iterable[WrongMessages]) -> tuple[WrongMessages, ...]:
    """Merge an agent's keys that were wrong in the same way; most messages come first.

    A device that does one thing wrong does it on all of its keys: that is one thing to read.
    """
    groups: dict[tuple[str, str], list[WrongMessages]] = {}
    for entry in wrong:
        groups.setdefault((entry.publisher or entry.key, entry.cause), []).append(entry)
    found = [
        replace(
            max(group, key=lambda entry: entry.count),
            key=f"{group[0].key} and {len(group) - 1} more" if group[1:] else group[0].key,
            count=sum(entry.count for entry in group),
        )
        for group in groups.values()
    ]
    return tuple(sorted(found, key=lambda entry: -entry.count))
