"""Controllers that die or stand still in the middle of a run, by themselves or by a fault rule."""

from __future__ import annotations

import os
import signal
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from agents.plan import RunPlan
from bus_schemas.faults import incidents
from launch_scripts.launcher.supervision import Child, Children

_LOOK_S: Final = 0.5
"""Time between two looks at who stands still."""

_SAME_CLOCK_S: Final = 10.0

_SIGNALS: Final = {"kill": signal.SIGKILL, "freeze": signal.SIGSTOP, "thaw": signal.SIGCONT}


class Restarts:
    """Starts controllers again, kills those that stand still, and does what fault rules ask for.

    Parameters
    ----------
    plan
        Of the run, with its policy.
    start
        Starts an agent's process.
    say
        Called with a line for the user.

    Attributes
    ----------
    counts
        How often each agent was started again.
    """

    def __init__(
        self, plan: RunPlan, start: Callable[[str], None], say: Callable[[str], None]
    ) -> None:
        self.counts: Counter[str] = Counter()
        self._policy = plan.restart
        self._allowed = plan.restart.when != "never" and not plan.lockstep
        self._start = start
        self._say = say
        self._times: dict[str, list[float]] = {}
        self._stopped_since: dict[str, float] = {}
        self._look_at = 0.0
        self._due = incidents(plan.faults, plan.tree)
        self._wall_per_s = plan.cycle_wall_ns / plan.cycle_ns
        self._began_at: float | None = None

    def begin(self, start_s: float) -> None:
        """Replace controllers and let rules act from the beginning of cycle 0 on."""
        now = time.monotonic()
        # An external plant on another host has another clock.
        self._began_at = start_s if abs(start_s - now) < _SAME_CLOCK_S else now

    def end(self) -> None:
        """Replace nobody any more: the run is over, and who ends now has nothing left to do."""
        self._began_at = None

    def replaces(self, child: Child, why: str) -> bool:
        """Start a controller again that has ended; return False if the policy does not."""
        if not self._allowed or self._began_at is None or child.kind in {"plant", "recorder"}:
            return False
        now, policy = time.monotonic(), self._policy
        recent = [at for at in self._times.get(child.agent, ()) if now - at < policy.within_s]
        if len(recent) >= policy.most:
            self._say(f"{child.agent} was started again {len(recent)} times: that is enough")
            return False
        self._times[child.agent] = [*recent, now]
        self.counts[child.agent] += 1
        self._stopped_since.pop(child.agent, None)
        self._say(f"{why.splitlines()[0].split('; last lines')[0]}; it is started again")
        child.begin_again()
        self._start(child.agent)
        return True

    def look(self, children: Children) -> None:
        """Do what is due by fault rules; kill controllers that have stood still for too long."""
        now = time.monotonic()
        if self._began_at is None:
            return
        since_s = now - self._began_at
        while self._due and self._due[0].time_s * self._wall_per_s <= since_s:
            incident = self._due.pop(0)
            self._say(f"fault: {incident.what} {incident.agent}")
            _send(children[incident.agent], _SIGNALS[incident.what])
        if self._allowed and now >= self._look_at:
            self._look_at = now + _LOOK_S
            self._kill_stopped(children, now)

    def _kill_stopped(self, children: Children, now: float) -> None:
        for child in children:
            if child.kind in {"plant", "recorder"} or not child.is_stopped():
                self._stopped_since.pop(child.agent, None)
                continue
            since = self._stopped_since.setdefault(child.agent, now)
            if now - since >= self._policy.frozen_s:
                stood_s = f"{self._policy.frozen_s:g} s"
                self._say(f"{child.agent} (process {child.pid}) has stood still for {stood_s}")
                _send(child, signal.SIGKILL)


def _send(child: Child, number: signal.Signals) -> None:
    if child.pid and child.exited is None:
        with suppress(ProcessLookupError):
            os.kill(child.pid, number)
