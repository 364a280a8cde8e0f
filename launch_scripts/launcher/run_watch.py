"""Whether a run is alive: when its recorder was last heard from, and when its plant went on.

The launcher sees the plant through the recorder: while that is silent, nothing is known of it.
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

LONGEST_STEP_S: Final = 0.5
"""Between two looks no more than this counts as silence: a launcher or a machine that stood still
proves nothing."""

_PER_PROCESS_S: Final = 0.01
"""How long both may at least take for each process of the run: 1,000 share few processors."""


class RunWatch:
    """The signs of life of one run, from its first cycle on. `say` shows a line to the user."""

    def __init__(self, plan: RunPlan, say: Callable[[str], None]) -> None:
        self._say = say
        least_s = _PER_PROCESS_S * len(plan.processes)
        patience_s = HEARTBEAT_S if plan.lockstep else PATIENCE_S
        if plan.restarts:  # Before that it is killed, and a new one begins.
            patience_s = plan.restart.frozen_s + PATIENCE_S
        self._patience_s = max(patience_s, least_s)
        self._cycle_s = max(PLANT_S, least_s, 3.0 * plan.cycle_wall_ns / 1e9)
        self._cycle = -1
        self._looked_at = 0.0
        self._stuck_s = 0.0
        self.recorder_silent_s = 0.0

    def begin(self, now_s: float) -> None:
        """Cycle 0 begins, or a new recorder is started."""
        self._looked_at = now_s
        self.recorder_silent_s = self._stuck_s = 0.0

    def hear(self, cycle: int) -> None:
        """Take in the recorder's report on where the run stands."""
        # The first report after a silence is from before the silence.
        if cycle != self._cycle or self.recorder_silent_s > HEARTBEAT_S:
            self._cycle, self._stuck_s = cycle, 0.0
        self.recorder_silent_s = 0.0

    def check(self, now_s: float) -> tuple[str, str] | None:
        """Return who has been silent for too long, and what to say of it.

        To be called several times a second.
        """
        step_s = min(now_s - self._looked_at, LONGEST_STEP_S)
        self._looked_at = now_s
        was_silent = self.recorder_silent_s > HEARTBEAT_S
        self.recorder_silent_s += step_s
        self._stuck_s += step_s
        if self.recorder_silent_s > self._patience_s:
            return RECORDER, f"recorder has been silent for {self._patience_s:g} s"
        if self.recorder_silent_s > HEARTBEAT_S:
            if not was_silent:
                self._say(f"recorder has been silent for {HEARTBEAT_S:g} s")
        elif self._stuck_s > self._cycle_s:
            return PLANT, f"plant has not completed a cycle for {self._cycle_s:g} s"
        return None
