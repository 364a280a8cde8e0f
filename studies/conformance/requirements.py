"""What docs/wire.md asks of a device, and what a trial has found of it."""

from __future__ import annotations

from typing import Final

from studies.tables import Table, key_column, word_column

REQUIREMENTS: Final[dict[str, str]] = {
    "token": "declares its liveliness token on each link, after its subscriptions",
    "arming": "answers arming rounds with their cycle, number 0, from its initial state",
    "decisions": "decides what Heliarch's own agent decides, and publishes nothing else",
    "head": "source, simulated time, sequence, incarnation and times are right",
    "bounds": "each message is of its type, and its numbers are within their bounds",
    "links": "each message reaches each of its listeners, once in a cycle",
    "limits": "inputs at and beyond their limits are used, held within or not used",
    "wrong messages": "drops messages that are undecodable, foreign, repeated, late or too early",
    "replaced": "uses nothing of a neighbour's process that has been replaced",
    "missing": "closes a stage at its deadline, with the newest messages",
    "silent": "an input older than `hold_cycles` counts for nothing",
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
    """What was tried, and the first failure of each requirement."""

    def __init__(self, requirements: dict[str, str]) -> None:
        self._requirements = requirements
        self._tried: set[str] = set()
        self._failures: dict[str, str] = {}
        self._doubts: dict[str, str] = {}
        self.doubt = ""
        """Why nothing that fails from now on is the device's fault for certain; empty: it is."""

    def try_(self, requirement: str) -> None:
        """Note that something puts a requirement to the test."""
        self._tried.add(requirement)

    def fail(self, requirement: str, text: str) -> None:
        """Note a failure, or that it cannot be judged."""
        self.try_(requirement)
        if self.doubt:
            self._doubts.setdefault(requirement, self.doubt)
        else:
            self._failures.setdefault(requirement, text)

    @property
    def passed(self) -> bool:
        """Whether nothing that was tried has failed, or could not be judged."""
        return not self._failures and not self._doubts

    def table(self, agent: str) -> Table:
        columns = (
            key_column("requirement"),
            word_column("result"),
            word_column("what a device must do, or the first failure", "text"),
        )
        results = (
            dict.fromkeys(self._requirements, "not tried")
            | dict.fromkeys(self._tried, "PASS")
            | dict.fromkeys(self._doubts, "too slow")
            | dict.fromkeys(self._failures, "FAIL")
        )
        texts = self._requirements | self._doubts | self._failures
        rows = tuple((name, results[name], texts[name]) for name in self._requirements)
        return Table(f"Conformance of {agent}", columns, rows)
