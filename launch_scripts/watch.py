"""Which processes live and which are heard. Each question has a witness of its own.

A process lives if it beats. Time counts only while the launcher itself runs: a launcher or a
machine that stood still proves nothing. The recorder and the listeners say which processes are
heard. External agents have no beat: they are only heard, or not.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from agents.plan import RunPlan
from agents.process.beats import BEAT_S, FORK_SERVER
from agents.process.events import Event, Joined, Presence, Started, Status
from bus_schemas.tree import OPERATOR, PLANT
from launch_scripts.supervision import Child, Children, Row, is_through

LONGEST_STEP_S: Final = 0.5
"""Between two looks of the launcher no more than this counts."""

_LOOK_S: Final = 0.2

JOIN_S: Final = 30.0
"""How long a process may take from its start until it is on the bus, where it begins to beat."""

SILENT_S: Final = 5.0
"""From when on the fork server counts as standing still; the plant, after twice that."""

GONE_S: Final = 2.0
"""How long a run waits for the return of an external agent without which it cannot go on."""


class Watch:
    """Judges which of the launcher's processes live.

    ran_s: How long the launcher has run [s].
    """

    def __init__(
        self, plan: RunPlan, children: Children, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self.ran_s = 0.0
        self._children = children
        self._now_s = now_s
        self._looked_at_s = now_s()
        self._look_at_s = 0.0
        self._server = Row("present")
        self._limit_s = plan.supervision.restart.frozen_s + BEAT_S
        cycle_s = plan.timing.cycle_wall_ns / 1e9
        # In lockstep a cycle may take any time.
        self._cycle_s = 3.0 * cycle_s + self._limit_s if cycle_s else None
        self._cycles = plan.timing.cycles

    def hear(self, child: Child, event: Event) -> None:
        """Count from the start of a process, and from when it is on the bus."""
        if isinstance(event, Started | Joined):
            child.row.beat_at_s = child.row.moved_at_s = self.ran_s
            child.row.cycle = -1

    def look(self) -> Iterator[tuple[Child, str]]:
        """Yield the processes that do not live, and why. To be called several times a second."""
        now_s = self._now_s()
        self.ran_s += min(now_s - self._looked_at_s, LONGEST_STEP_S)
        self._looked_at_s = now_s
        if self.ran_s < self._look_at_s:
            return
        self._look_at_s = self.ran_s + _LOOK_S
        self._see(FORK_SERVER, self._server)
        for child in self._children:
            sends = self._see(child.agent, child.row)
            if why := self._objection(child, sends=sends):
                yield child, why

    def silent_s(self, child: Child) -> float:
        """Return for how long a process has not beaten [s]."""
        return self.ran_s - child.row.beat_at_s

    @property
    def server_stands_still(self) -> bool:
        return self._server.beat_ns > 0 and self.ran_s - self._server.beat_at_s > SILENT_S

    def _see(self, name: str, row: Row) -> bool:
        """Take in the newest beat; return whether the process is sending."""
        beat = self._children.table.read(name)
        if beat.time_ns != row.beat_ns:
            row.beat_ns, row.beat_at_s = beat.time_ns, self.ran_s
            if beat.cycle != row.cycle:
                row.cycle, row.moved_at_s = beat.cycle, self.ran_s
        return beat.sends

    def _objection(self, child: Child, *, sends: bool) -> str:
        """Say why a process does not live; empty if it does."""
        row = child.row
        # In lockstep a process that sends waits for a listener.
        if is_through(child) or row.state not in {"started", "present"} or sends:
            return ""
        more_s = 2.0 * SILENT_S if child.kind == "plant" else 0.0
        limit_s = max(self._limit_s, more_s) if row.state == "present" else JOIN_S
        if self.silent_s(child) > limit_s:
            return f"has not beaten for {limit_s:.1f} s"
        if self._cycle_s is None or child.kind == "recorder" or not 0 <= row.cycle < self._cycles:
            return ""
        if self.ran_s - row.moved_at_s > self._cycle_s + more_s:
            return f"beats and stays in cycle {row.cycle}"
        return ""


class Externals:
    """The agents that the launcher does not start, as the recorder sees their liveliness tokens.

    complete_at: When all had been seen; None: some have not.
    unheard: Keys on which nothing came from them in the newest arming round.
    """

    def __init__(
        self,
        plan: RunPlan,
        say: Callable[[str], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.complete_at = None if plan.elsewhere else now_s()
        self.unheard: Sequence[str] = ()
        self._plan = plan
        self._say = say
        self._now_s = now_s
        self._seen: set[str] = set()
        self._gone_at_s: dict[str, float] = {}

    @property
    def awaited(self) -> list[str]:
        """Those that have not been seen."""
        return [name for name in self._plan.elsewhere if name not in self._seen]

    def hear(self, event: Event) -> None:
        if isinstance(event, Status):
            self.unheard = event.unheard
        elif isinstance(event, Presence):
            self._say(self._note(event))

    def _note(self, event: Presence) -> str:
        """Note that one has appeared or disappeared; return a message about it."""
        agent, plan, lockstep = event.agent, self._plan, self._plan.timing.lockstep
        name = f"{agent} ({plan.access.addresses.get(agent, 'external')})"
        when = f"in cycle {event.cycle}" if event.cycle >= 0 else "before cycle 0"
        if not event.alive:
            if event.cycle >= 0 and (agent == OPERATOR or (not lockstep and agent != PLANT)):
                return f"{name} is gone {when}; the run goes on without it"
            if event.cycle >= 0 and agent in plan.access.external:
                self._gone_at_s[agent] = self._now_s()
            return f"{name} is gone {when}"
        if not lockstep:  # There no message is sent twice: who comes back lacks what it missed.
            self._gone_at_s.pop(agent, None)
        if agent in self._seen:
            return f"{name} is back {when}"
        self._seen.add(agent)
        if not self.awaited:
            self.complete_at = self._now_s()
        return f"{name} is here"

    def failure(self) -> tuple[str, str] | None:
        """Return the agent whose absence has made the run fail, and a message about it."""
        for name, at_s in self._gone_at_s.items():
            if self._now_s() > at_s + GONE_S:
                return name, f"{name} is gone: the run cannot go on without it"
        return None
