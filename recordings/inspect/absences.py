"""An agent that was absent from a run for some cycles, and how that ended."""

from __future__ import annotations

from typing import Literal, TypeAlias

import msgspec

from bus_schemas.tree import RECORDER
from recordings.read.run_clock import RunClock

How: TypeAlias = Literal[
    "back", "restarted", "standby took over", "not back", "not heard", "cut off"
]


class Absence(msgspec.Struct, frozen=True):
    """An agent that was absent for some cycles; 0 of them if it only restarted.

    how: `back` as it was, `restarted` as another process, replaced by its standby, or `not back`:
        nothing of it came, and its numbers show that it published nothing. `not heard`: the
        recorder did not hear what it published. `cut off`: those who await its messages lacked
        them, or it lacked theirs. The recorder is `not heard` where it heard nobody.
    back_in: The cycle in which it was heard again, or its other process joined; None: it was not.
    cause: What a fault rule did to it.

    A real inverter is named `device c2/inv07`: it has no telemetry while it is gone.
    """

    agent: str
    first_cycle: int
    cycles: int
    back_in: int | None
    how: How = "back"
    cause: str = ""

    @property
    def end(self) -> int:
        return self.first_cycle + self.cycles

    @property
    def weight(self) -> tuple[bool, int]:
        """What it is sorted by: whether the agent came back as it was, and for how long."""
        return self.how != "back", self.cycles

    def is_near(self, other: Absence, cycles: int) -> bool:
        """Whether there are at most so many cycles between both."""
        return other.first_cycle <= self.end + cycles and self.first_cycle <= other.end + cycles

    def text(self, clock: RunClock) -> str:
        span = clock.span_text(self.first_cycle, self.end - 1) if self.cycles else ""
        if self.agent == RECORDER:
            return f"{self.agent}: recorded nothing {span}"
        if self.how == "not heard":
            return f"{self.agent}: not heard {span}, though it published"
        if self.how == "cut off":
            return f"{self.agent}: cut off {span}"
        gone = f"nothing {span}, " if span else ""
        cause = f"{self.cause}, " if self.cause else ""
        how = f"its {self.how}" if self.how.startswith("standby") else self.how
        back = "" if self.back_in is None else f" in cycle {self.back_in:,}"
        return f"{self.agent}: {gone}{cause}{how}{back}"
