"""Processes that die, or say nothing, in the middle of a run: killed, and started again."""

from __future__ import annotations

import signal
import time
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from typing import Final

from agents.plan import RunPlan
from agents.process.events import Event, Exited, Status, TookOver
from bus_schemas.tree import RECORDER, agent_of, standby_of
from launch_scripts.process_faults import ProcessFaults
from launch_scripts.supervision import Child, Children
from launch_scripts.watch import Watch
from recordings.record.monitor import longest_pause_s

_RETURN_S: Final = 10.0
"""In lockstep: how long a process that was started again may take to join."""


class Restarts:
    """Starts processes again and kills those that are unresponsive, by the policy of the plan.

    `start` starts a process, `say` shows a line to the user. `counts` says how often each process
    was started again. It also carries out the plan's fault rules.
    """

    def __init__(
        self,
        plan: RunPlan,
        children: Children,
        watch: Watch,
        start: Callable[[str], None],
        say: Callable[[str], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.counts: Counter[str] = Counter()
        self._plan = plan
        self._children = children
        self._watch = watch
        self._start = start
        self._say = say
        self._now_s = now_s
        self._faults = ProcessFaults(plan, watch, self._send, say)
        self._times: dict[str, list[float]] = {}
        self._start_at: dict[str, tuple[float, Exited | None]] = {}
        self._killed: set[str] = set()
        self._is_on = False
        children.replaces = self.replaces

    def begin(self, start_s: float) -> None:
        """Replace processes, and let rules act, from the beginning of cycle 0 on."""
        self._faults.begin(start_s, self._now_s())
        self._is_on = True

    def end(self) -> None:
        """Replace no more processes: the run is over."""
        self._is_on = False
        for name, (_, exited) in self._start_at.items():  # They do not come back.
            self._children[name].exited = exited
            self._killed.add(name)

    @property
    def lost_processes(self) -> bool:
        """Whether a process has ended that could not say what it had published."""
        return bool(self.counts or self._killed)

    def replaces(self, child: Child, why: str) -> bool:
        """Start a process again that has ended; return False if the policy does not.

        At the end of the run no process is started, and those that the launcher has killed may be
        missing.
        """
        if not self._plan.restarts or child.kind == "plant":
            return False
        if not self._is_on:
            return child.agent in self._killed
        name, now_s, policy = child.agent, self._now_s(), self._plan.supervision.restart
        earlier = self._times.setdefault(name, [])
        wait_s = policy.wait_s(earlier, now_s)
        if wait_s is None:
            self._say(f"{name} was started again {len(earlier)} times: restart.most allows no more")
            return False
        earlier.append(now_s)
        self.counts[name] += 1
        if name not in self._killed:
            self._say(f"{why}; it is started again")
        self._killed.discard(name)
        self._start_at[name] = now_s + wait_s, child.exited
        child.begin_again()
        self._start_due(now_s)
        return True

    def look(self) -> None:
        """Do what is due: fault rules, and processes that were to wait. Look at the recorder."""
        if not self._is_on:
            return
        now_s = self._now_s()
        self._start_due(now_s)
        self._faults.look(now_s)
        recorder = self._watch.rows.get(RECORDER)
        is_frozen = recorder and recorder.unheard_s >= self._plan.supervision.restart.frozen_s
        if self._plan.restarts and is_frozen:
            self._kill_unresponsive(self._children[RECORDER])

    def hear(self, child: Child, event: Event) -> None:
        """Take in what a process says of itself, or the recorder of the controllers."""
        match event:
            case TookOver():
                self._say(f"{child.agent} took over in cycle {event.cycle}")
                if not self._watch.take_over(child.agent, event.cycle):
                    self._send(standby_of(agent_of(child.agent)), signal.SIGKILL)
            case Status() if self._is_on:
                self.judge(event.unresponsive, longest_pause_s(self._plan))

    def judge(self, unheard: Collection[str], unheard_s: float) -> None:
        """Kill controllers that were not heard for too long, see `Watch.unresponsive`."""
        for name in self._watch.unresponsive(unheard, unheard_s):
            if self._plan.restarts:
                self._kill_unresponsive(self._children[name])

    def mends(self, to_blame: Sequence[str]) -> bool:
        """In lockstep: start again those that a stalled run waits for, or wait for their return."""
        children = [self._children.by_agent.get(name) for name in to_blame]
        if not self._plan.restarts or not self._is_on:
            return False
        for child in children:
            if child is None or child.kind in {"plant", "recorder"} or child.waiting is not None:
                return False
            if self._now_s() - max(self._times.get(child.agent, [0.0])) > _RETURN_S:
                self._kill_unresponsive(child)
        return True

    def _start_due(self, now_s: float) -> None:
        for name in [name for name, (at, _) in self._start_at.items() if at <= now_s]:
            del self._start_at[name]
            self._start(name)

    def _kill_unresponsive(self, child: Child) -> None:
        if child.pid and child.agent not in self._killed:
            self._say(f"{child.agent} (process {child.pid}) says nothing: killed and started again")
            self._send(child.agent, signal.SIGKILL)

    def _send(self, name: str, number: signal.Signals) -> None:
        child = self._children[name]
        if child.pid and child.exited is None:
            if number == signal.SIGKILL:
                self._killed.add(name)
            self._children.signal([name], number)
