"""Processes that die, or say nothing, in the middle of a run, by themselves or by a fault rule."""

from __future__ import annotations

import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Final

from agents.events import Event, Exited, Standing, Status, TookOver
from agents.plan import RunPlan
from agents.process import STANDING_S
from bus_schemas.faults import incidents
from bus_schemas.tree import RECORDER, agent_of, standby_of
from launch_scripts.launcher.run_watch import LONGEST_STEP_S
from launch_scripts.launcher.supervision import Child, Children
from recordings.record.recorder import longest_pause_s

_RETURN_S: Final = 10.0
"""In lockstep: how long a process that was started again may take to join."""

_SAME_CLOCK_S: Final = 10.0
"""If cycle 0 began farther from now, it was by the clock of another host."""

_SIGNALS: Final = {"kill": signal.SIGKILL, "freeze": signal.SIGSTOP, "thaw": signal.SIGCONT}


class Restarts:
    """Starts processes again, kills those that say nothing, and does what fault rules ask for.

    `start` starts a process, `say` is called with a line for the user. `counts` says how often each
    process was started again, `takeovers` how often a standby has taken each agent over.
    """

    def __init__(
        self,
        plan: RunPlan,
        children: Children,
        start: Callable[[str], None],
        say: Callable[[str], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.counts: Counter[str] = Counter()
        self.takeovers: Counter[str] = Counter()
        self._policy = plan.restart
        self._allowed = plan.restarts
        self._children = children
        self._start = start
        self._say = say
        self._now_s = now_s
        self._times: dict[str, list[float]] = {}
        self._start_at: dict[str, tuple[float, Exited | None]] = {}
        self._killed: set[str] = set()
        self._due = incidents(plan.faults, plan.tree)
        self._frozen: dict[str, Child] = {}
        self._wall_per_s = plan.cycle_wall_ns / plan.cycle_ns
        self._began_at: float | None = None
        # The process that speaks for an agent with a standby, and since which cycle.
        self._speaker = {agent: (agent, 0) for agent in plan.standbys}
        self._pause_s = longest_pause_s(plan)
        self._status_at = 0.0
        self._silent_s: dict[str, float] = {}
        children.replaces = self.replaces

    def begin(self, start_s: float) -> None:
        """Replace processes and let rules act from the beginning of cycle 0 on."""
        now = self._status_at = self._now_s()
        self._began_at = start_s if abs(start_s - now) < _SAME_CLOCK_S else now

    def end(self) -> None:
        """Replace nobody any more: the run is over, and who ends now has nothing left to do."""
        self._began_at = None
        for name, (_, exited) in self._start_at.items():  # They do not come back.
            self._children[name].exited = exited
            self._killed.add(name)

    @property
    def lost_processes(self) -> bool:
        """Whether a process has ended that could not say what it had published."""
        return bool(self.counts or self._killed)

    def replaces(self, child: Child, why: str) -> bool:
        """Start a process again that has ended; return False if the policy does not.

        At the end of the run nobody is started, but those whom the launcher has killed may be away.
        """
        if not self._allowed or child.kind == "plant":
            return False
        if self._began_at is None:
            return child.agent in self._killed
        name, now = child.agent, self._now_s()
        earlier = self._times.setdefault(name, [])
        wait_s = self._policy.wait_s(earlier, now)
        if wait_s is None:
            self._say(f"{name} was started again {len(earlier)} times: that is enough")
            return False
        earlier.append(now)
        self.counts[name] += 1
        if name not in self._killed:
            self._say(f"{why}; it is started again")
        self._killed.discard(name)
        self._silent_s.pop(name, None)
        self._start_at[name] = now + wait_s, child.exited
        child.begin_again()
        self._start_due(now)
        return True

    def look(self, recorder_silent_s: float) -> None:
        """Do what is due: by fault rules, and to those that were to wait or that say nothing."""
        now = self._now_s()
        if self._began_at is None:
            return
        self._start_due(now)
        while self._due and self._due[0].time_s * self._wall_per_s <= now - self._began_at:
            incident = self._due.pop(0)
            child = self._victim(incident.agent, incident.what)
            self._say(f"fault: {incident.what} {child.agent}")
            self._send(child, _SIGNALS[incident.what])
        if self._allowed and recorder_silent_s >= self._policy.frozen_s:
            self._kill_silent(self._children[RECORDER])

    def hear(self, child: Child, event: Event) -> None:
        """Take in what a process says of itself, or the recorder of all others."""
        match event:
            case Standing():
                self._silent_s.pop(child.agent, None)
            case TookOver():
                self._note_takeover(child.agent, event.cycle)
            case Status() if self._began_at is not None:
                self.note_silence(event.silent, self._pause_s)

    def note_silence(self, silent: Sequence[str], for_s: float) -> None:
        """Count how long each controller has said nothing, and kill it after a while.

        To be called again and again with those that have said nothing for so long [s].
        """
        now = self._now_s()
        step_s, self._status_at = min(now - self._status_at, LONGEST_STEP_S), now
        for child in self._children.controllers():
            name, agent = child.agent, agent_of(child.agent)
            speaks = self._speaker.get(agent, (name, 0))[0] == name
            if child.kind == "plant" or not child.pid or (speaks and agent not in silent):
                self._silent_s.pop(name, None)
                continue
            before_s = self._silent_s.get(name, 0.0)
            self._silent_s[name] = before_s + step_s
            # One that stands by says so every now and then.
            pause_s = for_s if speaks else -2.0 * STANDING_S
            if speaks and 0.0 < before_s <= LONGEST_STEP_S < before_s + step_s:
                self._say(f"{name} (process {child.pid}) says nothing")
            if self._allowed and before_s and before_s + step_s + pause_s >= self._policy.frozen_s:
                self._kill_silent(child)

    def mends(self, to_blame: Sequence[str]) -> bool:
        """In lockstep: start again those that a stalled run waits for, or wait for their return."""
        children = [self._children.by_agent.get(name) for name in to_blame]
        if not self._allowed or self._began_at is None:
            return False
        for child in children:
            if child is None or child.kind in {"plant", "recorder"} or child.waiting is not None:
                return False
            if self._now_s() - max(self._times.get(child.agent, [0.0])) > _RETURN_S:
                self._kill_silent(child)
        return True

    def _start_due(self, now: float) -> None:
        for name in [name for name, (at, _) in self._start_at.items() if at <= now]:
            del self._start_at[name]
            self._start(name)

    def _victim(self, agent: str, what: str) -> Child:
        """Return the process that a rule means: the one that speaks, or that stands still."""
        child = self._children[self._speaker.get(agent, (agent, 0))[0]]
        if what == "freeze":
            self._frozen[agent] = child
        return self._frozen.pop(agent, child) if what == "thaw" else child

    def _note_takeover(self, name: str, cycle: int) -> None:
        agent = agent_of(name)
        self._say(f"{name} took over in cycle {cycle}")
        self.takeovers[agent] += 1
        before, since = self._speaker[agent]
        self._speaker[agent] = (name, cycle)
        if since == cycle and before != name:  # Both at once: neither would yield to the other.
            self._speaker[agent] = (agent, cycle)
            self._send(self._children[standby_of(agent)], signal.SIGKILL)

    def _kill_silent(self, child: Child) -> None:
        if child.pid and child.agent not in self._killed:
            self._say(f"{child.agent} (process {child.pid}) says nothing: killed and started again")
            self._send(child, signal.SIGKILL)

    def _send(self, child: Child, number: signal.Signals) -> None:
        if child.pid and child.exited is None:
            if number == signal.SIGKILL:
                self._killed.add(child.agent)
            with suppress(ProcessLookupError):
                os.kill(child.pid, number)
