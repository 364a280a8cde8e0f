"""Does to controllers what the fault rules of a run say: kills, freezes and thaws them."""

from __future__ import annotations

import signal
from collections.abc import Callable
from typing import Final

from agents.faults import incidents
from agents.plan import RunPlan
from launch_scripts.watch import Watch

_SAME_CLOCK_S: Final = 10.0
"""If cycle 0 began farther from now, it was by the clock of another host."""

_SIGNALS: Final = {"kill": signal.SIGKILL, "freeze": signal.SIGSTOP, "thaw": signal.SIGCONT}


class ProcessFaults:
    """The rules of a run. `send` sends a signal to a process, `say` shows a line to the user."""

    def __init__(
        self,
        plan: RunPlan,
        watch: Watch,
        send: Callable[[str, signal.Signals], None],
        say: Callable[[str], None],
    ) -> None:
        self._watch = watch
        self._send = send
        self._say = say
        self._due = incidents(plan.faults.rules, plan.tree)
        self._frozen: dict[str, str] = {}
        self._wall_per_s = plan.timing.cycle_wall_ns / plan.timing.cycle_ns
        self._began_at = 0.0

    def begin(self, start_s: float, now_s: float) -> None:
        """Count time from the beginning of cycle 0 on."""
        self._began_at = start_s if abs(start_s - now_s) < _SAME_CLOCK_S else now_s

    def look(self, now_s: float) -> None:
        """Do what is due."""
        while self._due and self._due[0].time_s * self._wall_per_s <= now_s - self._began_at:
            incident = self._due.pop(0)
            name = self._process_of(incident.agent, incident.what)
            self._say(f"fault: {incident.what} {name}")
            self._send(name, _SIGNALS[incident.what])

    def _process_of(self, agent: str, what: str) -> str:
        """Return the process that a rule means: the one that speaks, or that was frozen."""
        name = self._watch.speaker(agent)
        if what == "freeze":
            self._frozen[agent] = name
        return self._frozen.pop(agent, name) if what == "thaw" else name
