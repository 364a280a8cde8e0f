"""Messages that could not be used, by key and cause: what recorder and listeners say of them.

The recorder hears everything, but takes no part in cycles. An agent hears only its own keys, and
knows what came too late. Both may have counted the same message: the larger count holds.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from agents.events import Complaint
from agents.plan import RunPlan
from recordings.inspect.health import WrongMessages


def wrong_messages(
    plan: RunPlan,
    complaints: Iterable[Complaint],
    dropped: Iterable[tuple[str, str, int]],
) -> tuple[WrongMessages, ...]:
    """Return the wrong messages of a run by key and cause, the most frequent first.

    Of what agents `dropped` (port, cause and number) only that of external agents counts: a late
    message of a process is the machine's fault.
    """
    publishers = {str(port): port.publisher for port in plan.wiring.ports}
    theirs = {port for port, publisher in publishers.items() if publisher in plan.external}
    counts: Counter[tuple[str, str]] = Counter()
    for port, cause, count in dropped:
        if port in theirs:
            counts[port, cause] += count
    examples = dict.fromkeys(counts, "dropped by an agent")
    for complaint in complaints:
        place = (complaint.key.removeprefix(f"{plan.plant}/"), complaint.cause)
        counts[place] = max(counts[place], complaint.count)
        examples[place] = complaint.example
    return tuple(
        WrongMessages(key, cause, count, examples[key, cause], publishers.get(key, ""))
        for (key, cause), count in counts.most_common()
    )
