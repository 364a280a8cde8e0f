"""Processes that die, or do not live, in a run: killed, started again, or given up."""

from __future__ import annotations

import signal
import time
from collections import Counter
from collections.abc import Callable, Sequence
from math import inf
from typing import Final

from agents.faults import Incident, incidents
from agents.plan import RunPlan
from agents.process.events import Exited
from bus_schemas.tree import PLANT, RECORDER
from launch_scripts.supervision import Child, Children
from launch_scripts.watch import Watch

_RETURN_S: Final = 10.0
"""In lockstep: how long a process that was started again may take to join."""

_KILLS_APART_S: Final = 1.0
"""Time between two kills of processes that no signal has stopped. On a machine that is too busy,
where each death makes more work, many healthy ones seem dead at once."""

_SAME_CLOCK_S: Final = 10.0
"""If cycle 0 began farther from now, it was by the clock of another host."""

_SIGNALS: Final = {"kill": signal.SIGKILL, "freeze": signal.SIGSTOP, "thaw": signal.SIGCONT}


class Restarts:
    """Kills processes that do not live, and starts those again that end, by the plan's policy.

    One that has ended too often is given up. It also carries out the plan's fault rules.

    start: Starts the process of a name. `say` shows a line to the user.

    counts: How often each process was started again.
    given_up: Processes that are not started again, and the plant's cycle at that time.
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
        self.given_up: dict[str, int] = {}
        self._plan = plan
        self._children = children
        self._watch = watch
        self._start = start
        self._say = say
        self._now_s = now_s
        self._faults = _FaultRules(plan)
        self._is_over = False
        # Processes that this has killed and that have not been started again.
        self._killed: set[str] = set()
        # When each process was started again, monotonic [s].
        self._times: dict[str, list[float]] = {}
        # Processes that wait to be started: when they are due, and how they have ended.
        self._start_at: dict[str, tuple[float, Exited | None]] = {}
        # When the next process may be killed, by the watch's clock.
        self._kill_at_s = 0.0
        # Processes that stay away, however often they are started again.
        self._stay_away: set[str] = set()
        self._server_stands_still = False
        children.on_death = self.on_death

    def begin(self, start_s: float) -> None:
        """Cycle 0 begins: let fault rules act from now on."""
        now_s = self._now_s()
        self._children.phase = "in the middle of the run"
        self._faults.begin_s = start_s if abs(start_s - now_s) < _SAME_CLOCK_S else now_s

    def end(self) -> None:
        """Start no more processes: the run is over."""
        self._is_over = True
        self._children.phase = "at the end of the run"
        for name, (_, exited) in self._start_at.items():  # They do not come back.
            self._children[name].exited = exited
        self._start_at.clear()

    def end_by_force(self, children: Sequence[Child]) -> None:
        """Kill processes that do not end with the run."""
        for child in children:
            self._say(f"{child.agent} (process {child.pid}) did not end with the run: killed")
            if child.finished is None and child.recorded is None:
                self.given_up.setdefault(child.agent, max(child.row.cycle, 0))
            self._send(child.agent, signal.SIGKILL)

    @property
    def lost_processes(self) -> bool:
        """Whether a process has ended that could not say what it had published."""
        return bool(self.counts or self._killed or self.given_up)

    def on_death(self, child: Child, why: str) -> bool:
        """Start a process again that has ended, or give it up; return whether the run goes on."""
        name, now_s = child.agent, self._now_s()
        if child.kind == "plant" or (child.failed is not None and not self._faults.has_begun):
            return False
        was_killed = name in self._killed
        if self._is_over:
            self._killed.add(name)
            if not was_killed:
                self._say(why)
            return True
        self._killed.discard(name)
        earlier = self._times.setdefault(name, [])
        policy = self._plan.supervision.restart
        # Before cycle 0, and of the recorder, a new process is as good as the first one.
        may_return = self._plan.restarts or not self._faults.has_begun or name == RECORDER
        may_return &= name not in self._stay_away
        wait_s = policy.wait_s(earlier, now_s) if may_return else None
        if wait_s is None:
            return self._give_up(child, why)
        earlier.append(now_s)
        self.counts[name] += 1
        if not was_killed:
            self._say(f"{why}; it is started again")
        self._start_at[name] = now_s + wait_s, child.exited
        child.begin_again()
        self._start_due(now_s)
        return True

    def look(self) -> None:
        """Do what is due: fault rules, processes that wait to be started; kill who does not live.

        Raises FailureError: the plant's process does not live.
        """
        now_s = self._now_s()
        self._start_due(now_s)
        for incident in self._faults.due(now_s) if not self._is_over else ():
            self._say(f"fault: {incident.what} {incident.agent}")
            self._send(incident.agent, _SIGNALS[incident.what])
        if self._watch.server_stands_still != self._server_stands_still:
            self._server_stands_still ^= True
            does = "stands still" if self._server_stands_still else "goes on"
            self._say(f"the fork server (process {self._children.server.process.pid}) {does}")
        is_judged = self._plan.restarts or self._plan.timing.lockstep
        for child, why in self._watch.look() if self._faults.has_begun else ():
            if child.kind == "plant":
                raise self._children.failure(PLANT, f"plant (process {child.pid}) {why}")
            if is_judged or child.kind == "recorder":
                self.kill(child, why)

    def mends(self, to_blame: Sequence[str]) -> bool:
        """In lockstep: kill those that a stalled run waits for, or wait for their return."""
        children = [self._children.by_agent.get(name) for name in to_blame]
        if self._is_over or PLANT not in self._children.by_agent:
            return False
        for child in children:
            if child is None or child.kind in {"plant", "recorder"}:
                return False
            if child.row.state == "given up":
                continue
            if self._now_s() - max(self._times.get(child.agent, [0.0])) > _RETURN_S:
                self.kill(child, "does not go on")
        return True

    def _give_up(self, child: Child, why: str) -> bool:
        """Go on without a process; return False if the run cannot.

        In lockstep the others wait for it, unless the plant tells them not to.
        """
        is_told = PLANT in self._children.by_agent or not self._plan.timing.lockstep
        if not self._faults.has_begun or not (is_told or child.kind == "recorder"):
            return False
        name = child.agent
        self.given_up[name] = max(self._children.table.read(PLANT).cycle, 0)
        child.row.state = "given up"
        times = f" after {self.counts[name]} restarts" if self.counts[name] else ""
        self._say(f"{why}; it is given up{times}: the run goes on without {name}")
        self._children.table.give_up(name)
        return True

    def _start_due(self, now_s: float) -> None:
        for name in [name for name, (at, _) in self._start_at.items() if at <= now_s]:
            del self._start_at[name]
            self._start(name)

    def kill(self, child: Child, why: str, *, may_return: bool = True) -> bool:
        """Kill a process that does not live, or is not heard; return whether it was its turn."""
        ran_s = self._watch.ran_s
        if not child.pid or child.agent in self._killed:
            return False
        if not child.is_stopped():
            if ran_s < self._kill_at_s:
                return False
            self._kill_at_s = ran_s + _KILLS_APART_S
        if not may_return:
            self._stay_away.add(child.agent)
        self._say(f"{child.agent} (process {child.pid}) {why}: killed")
        self._send(child.agent, signal.SIGKILL)
        return True

    def _send(self, name: str, number: signal.Signals) -> None:
        child = self._children[name]
        if child.pid and child.exited is None:
            if number == signal.SIGKILL:
                self._killed.add(name)
            self._children.signal([name], number)


class _FaultRules:
    """What the fault rules of a run do to controllers: kill, freeze and thaw them."""

    def __init__(self, plan: RunPlan) -> None:
        self._due = incidents(plan.faults.rules, plan.tree, plan.wiring)
        self._process_of = plan.wiring.process_of
        self._wall_per_s = plan.timing.cycle_wall_ns / plan.timing.cycle_ns
        self.begin_s = inf  # Of cycle 0.

    @property
    def has_begun(self) -> bool:
        return self.begin_s < inf

    def due(self, now_s: float) -> list[Incident]:
        """Return what is due, with the names of the processes that it happens to."""
        found: list[Incident] = []
        while self._due and self._due[0].time_s * self._wall_per_s <= now_s - self.begin_s:
            one = self._due.pop(0)
            found.append(one._replace(agent=self._process_of(one.agent)))
        return [*dict.fromkeys(found)]
