"""What docs/wire.md requires of a device, and what was found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from results.tables import Table, key_column, word_column

REQUIREMENTS: Final[dict[str, str]] = {
    "token": "declares its liveliness token on each link, after its subscriptions",
    "arming": "answers arming rounds, each key in each round",
    "decisions": "decides what Heliarch's own agent decides, and publishes nothing else",
    "head": "source, simulated time, sequence, incarnation and times are right",
    "bounds": "each message is of its type, and its numbers are within their bounds",
    "links": "each message reaches each of its listeners, once in a cycle",
    "limits": "inputs at and beyond their limits are used, held within or not used",
    "wrong messages": "drops undecodable, duplicate and late messages, and those of wrong senders",
    "replaced": "uses nothing of a neighbour's process that has been replaced",
    "missing": "closes a stage at its deadline, with the newest messages",
    "expired": "an input older than `hold_cycles` counts for nothing",
    "late": "a late message is used in the next decision",
    "random faults": "all of this holds under random loss, delay, repetition and reordering",
    "restart": "a new process joins the run in the cycle under way, and counts from 0",
    "stop": "publishes nothing after the last cycle",
}
"""Requirements by name, in the order of the report."""

_RESULTS: Final = ("not tried", "PASS", "too slow", "FAIL")


class Failure(NamedTuple):
    """What is wrong in a cycle.

    requirement: What it fails; empty: what the cycle shows.
    message: Its key; empty: no single one is wrong.
    trial, inputs: In which launch, and what the device was sent in the cycle.
    """

    requirement: str
    text: str
    cycle: int | None = None
    message: str = ""
    trial: str = ""
    inputs: Mapping[str, list[dict[str, Any]]] = {}


class Findings:
    """The result for each requirement: the worst that was found, and the first text of that.

    failures: All of them, in the order of trials and cycles.
    """

    def __init__(self) -> None:
        self.failures: list[Failure] = []
        self._found = {name: ("not tried", text) for name, text in REQUIREMENTS.items()}

    def note(self, requirement: str, result: str, text: str = "") -> None:
        before, its_text = self._found[requirement]
        if _RESULTS.index(result) > _RESULTS.index(before):
            self._found[requirement] = result, text or its_text

    def fail(self, failure: Failure) -> None:
        self.failures.append(failure)
        self.note(failure.requirement, "FAIL", failure.text)

    @property
    def passed(self) -> bool:
        return {result for result, _ in self._found.values()} <= {"not tried", "PASS"}

    def table(self, agent: str) -> Table:
        columns = (
            key_column("requirement"),
            word_column("result"),
            word_column("what a device must do, or the first failure", "text"),
        )
        more = Counter(failure.requirement for failure in self.failures)
        rows = [
            (name, result, f"{text} (and {more[name] - 1:,} more)" if more[name] > 1 else text)
            for name, (result, text) in self._found.items()
        ]
        return Table(f"Conformance of {agent}", columns, rows)
