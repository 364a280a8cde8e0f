"""Which live processes are heard, by their listeners and by the recorder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Final

from agents.plan import RunPlan
from agents.process.beats import BEAT_S
from agents.process.events import Status
from agents.process.session import link_times
from bus_schemas.tree import PLANT, RECORDER
from launch_scripts.restarts import Restarts
from launch_scripts.supervision import Child, Children, is_through
from launch_scripts.watch import Watch

_SPARE_S: Final = 1.0
"""Beyond the time in which a dead link is closed and opened anew by itself: for the first messages
to come."""


class Hearing:
    """Which live processes are not heard, by their listeners or by the recorder.

    One that no listener hears for longer than a dead link needs to close and to open anew is
    started again, and once more after twice the time, until it is given up. If the recorder does
    not hear the plant, the recorder is cut off, and the run goes on.

    gaps: First and last cycle that are not recorded. The last is the plant's newest so far while
        the gap is open.
    """

    def __init__(
        self,
        plan: RunPlan,
        children: Children,
        watch: Watch,
        restarts: Restarts,
        say: Callable[[str], None],
    ) -> None:
        self.gaps: list[tuple[int, int]] = []
        self._children = children
        self._process_of = plan.wiring.process_of
        self._watch = watch
        self._restarts = restarts
        self._say = say
        self._is_cut = False
        self._recorded = -1
        # Where links are cut by a fault rule, not being heard proves nothing.
        self._is_judged = plan.restarts and not plan.network_faults().acts
        self._patience_s = sum(link_times(plan)) + _SPARE_S
        self._since_s: dict[str, float] = {}
        self._policy = plan.supervision.restart
        self._in_a_row: Counter[str] = Counter()

    def hear(self, status: Status) -> None:
        """Take in whom the listeners do not hear, and whom the recorder does not."""
        live = {child.agent for child in self._children if self._lives(child)}
        if self._is_judged:
            self._judge(live, set(status.not_heard))
        if PLANT in live:
            self._recorded = max(self._recorded, status.cycle)
            not_recorded = live.intersection(map(self._process_of, status.not_recorded))
            hears_none = live - {RECORDER} <= not_recorded
            self._note_gap(hears_plant=PLANT not in not_recorded, hears_none=hears_none)

    def _judge(self, live: set[str], not_heard: set[str]) -> None:
        for name in live - not_heard:
            self._since_s.pop(name, None)
            self._in_a_row.pop(name, None)
        for name in not_heard & live - {PLANT}:
            since_s = self._since_s.setdefault(name, self._watch.ran_s)
            row = self._in_a_row[name]
            patience_s = self._patience_s * 2.0**row
            if self._watch.ran_s > since_s + patience_s:
                may_return = self._policy.when == "always" or row < self._policy.most
                why = f"lives, and no listener has heard it for {patience_s:.0f} s"
                if self._restarts.kill(self._children[name], why, may_return=may_return):
                    del self._since_s[name]
                    self._in_a_row[name] += 1

    def _note_gap(self, *, hears_plant: bool, hears_none: bool) -> None:
        newest, first = self._children[PLANT].row.cycle, self._recorded + 1
        if hears_plant and self._is_cut:
            self._is_cut = False
            self.gaps[-1] = self.gaps[-1][0], first - 2
            self._say(f"recorder hears the plant again, in cycle {first - 1:,}")
        elif not hears_plant and newest > first:
            if not self._is_cut:
                self._is_cut = True
                self.gaps.append((first, newest))
                unheard = "any agent" if hears_none else "the plant"
                where = f"since cycle {first:,} it does not hear {unheard}"
                self._say(f"recorder is cut off: {where}; the run goes on")
            self.gaps[-1] = self.gaps[-1][0], newest

    def _lives(self, child: Child) -> bool:
        return child.ready and not is_through(child) and self._watch.silent_s(child) < 2.0 * BEAT_S
