"""Whether a run is alive: when its recorder was last heard from, and when its plant went on.

The launcher sees the plant through the recorder. While the recorder is silent, the plant counts as
alive, since nothing is known of it. A time in which the launcher itself stood still does not count
either.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from agents.plan import RunPlan
from bus_schemas.tree import PLANT, RECORDER

PATIENCE_S: Final = 10.0
"""How long the recorder may stand still in real time, where messages queue up for it meanwhile; or
may take to come back, where it is started again."""

HEARTBEAT_S: Final = 2.0
"""The recorder reports a few times a second: silence for this long is a fault."""

PLANT_S: Final = 5.0
"""How long a cycle of the plant may take; cycles that are long on the wall clock get more."""

_PER_PROCESS_S: Final = 0.01
"""How long both may at least take for each process of the run: 1,000 share few processors."""

_OWN_PAUSE_S: Final = 0.5
"""If the launcher has not looked for so long, it stood still itself."""

_LOOK_S: Final = 0.1
"""How often it looks otherwise. This much of each pause counts, so that a launcher that is always
slow still finds faults."""


class RunWatch:
    """The signs of life of one run, from its first cycle on.

    In lockstep every agent soon waits for a recorder that stands still, and the run stalls. In
    real time none does: the messages queue up and are recorded later. Where processes are started
    again, it is killed after a while and everybody goes on.

    `say` is called with a line for the user.
    """

    def __init__(self, plan: RunPlan, say: Callable[[str], None]) -> None:
        self._say = say
        least_s = _PER_PROCESS_S * len(plan.processes)
        self._patience_s = max(HEARTBEAT_S if plan.lockstep else PATIENCE_S, least_s)
        longest_s, then = self._patience_s, "the run ends"
        if plan.restarts:
            longest_s, then = plan.restart.frozen_s, "it is killed and started again"
            self._patience_s = longest_s + PATIENCE_S
        meanwhile = "waits for it" if plan.lockstep else "goes on without it"
        self._what_next = f"the run {meanwhile}; if it stays silent for {longest_s:g} s, {then}"
        self._cycle_s = max(PLANT_S, least_s, 3.0 * plan.cycle_wall_ns / 1e9)
        self._cycle = -1
        self._heard_at = self._went_on_at = self._looked_at = 0.0
        self._is_silent = False

    def begin(self, now_s: float) -> None:
        """Cycle 0 begins, or a new recorder is started."""
        self._heard_at = self._went_on_at = self._looked_at = now_s

    def hear(self, cycle: int, now_s: float) -> None:
        """Take in the recorder's report on where the run stands."""
        self._heard_at = now_s
        if cycle != self._cycle or self._is_silent:
            # The first report after a silence is from before the silence.
            self._cycle, self._went_on_at = cycle, now_s
        self._is_silent = False

    def recorder_silent_s(self, now_s: float) -> float:
        self._leave_out_own_pause(now_s)
        return now_s - self._heard_at

    def check(self, now_s: float) -> tuple[str, str] | None:
        """Return who has been silent for too long, and what to say of it.

        A tolerable silence is only reported. To be called several times a second.
        """
        silent_s = self.recorder_silent_s(now_s)
        if silent_s > self._patience_s:
            return RECORDER, f"recorder has been silent for {self._patience_s:g} s"
        if silent_s > HEARTBEAT_S and not self._is_silent:
            self._is_silent = True
            self._say(f"recorder has been silent for {HEARTBEAT_S:g} s; {self._what_next}")
        if not self._is_silent and now_s - self._went_on_at > self._cycle_s:
            return PLANT, f"plant has not completed a cycle for {self._cycle_s:g} s"
        return None

    def _leave_out_own_pause(self, now_s: float) -> None:
        """Extend all time-outs by the time in which nobody has looked."""
        pause_s = now_s - self._looked_at
        self._looked_at = now_s
        if pause_s > _OWN_PAUSE_S:
            left_out_s = pause_s - _LOOK_S
            self._heard_at = min(self._heard_at + left_out_s, now_s)
            self._went_on_at = min(self._went_on_at + left_out_s, now_s)
