"""What docs/wire.md requires of a device, and what a trial has found."""

from __future__ import annotations

from typing import Final

from results.tables import Table, key_column, word_column

REQUIREMENTS: Final[dict[str, str]] = {
    "token": "declares its liveliness token on each link, after its subscriptions",
    "arming": "answers arming rounds with their cycle, number 0, from its initial state",
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
    "links closed": "forgets a run whose links close without a stop, and joins the next one",
    "restart": "a new process joins the run in the cycle under way, and counts from 0",
    "stop": "publishes nothing after the last cycle",
}
"""Requirements of a controller by name, in the order of the report."""

OF_PLANT: Final[dict[str, str]] = {
    "token": "declares its liveliness token on each link, after its subscriptions",
    "arming": "conducts arming rounds, and begins the run once one is closed",
    "cycles": "publishes each of its signals in each cycle, once, and on no other keys",
    "head": "source, simulated time, sequence and times are right",
    "bounds": "each message is of its type, and its numbers are within their bounds",
    "links": "each listener decides on what was recorded",
    "missing": "completes its cycles in real time also without a command",
    "stop": "completes all cycles, and says that the run is over",
}
"""Requirements of a plant."""


class Findings:
    """Whether each requirement was tested, and its first failure."""

    def __init__(self, requirements: dict[str, str]) -> None:
        self._requirements = requirements
        self._found = {name: ("not tried", text) for name, text in requirements.items()}
        self.doubt = ""
        """Why failures from now on may not be the device's fault; empty: they are."""

    def try_(self, requirement: str) -> None:
        """Note that something puts a requirement to the test."""
        if self._found[requirement][0] == "not tried":
            self._found[requirement] = "PASS", self._requirements[requirement]

    def fail(self, requirement: str, text: str) -> None:
        """Note a failure, or that it cannot be judged."""
        result, _ = self._found[requirement]
        if result == "FAIL" or (self.doubt and result == "too slow"):
            return
        self._found[requirement] = ("too slow", self.doubt) if self.doubt else ("FAIL", text)

    @property
    def passed(self) -> bool:
        """Whether nothing that was tried has failed, or could not be judged."""
        return {result for result, _ in self._found.values()} <= {"not tried", "PASS"}

    def table(self, agent: str) -> Table:
        columns = (
            key_column("requirement"),
            word_column("result"),
            word_column("what a device must do, or the first failure", "text"),
        )
        rows = [(name, *found) for name, found in self._found.items()]
        return Table(f"Conformance of {agent}", columns, rows)
