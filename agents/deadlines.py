"""When, in real time, each stage of a cycle must close at the latest.

The stages follow one another through the tree: a pass down (request), a pass up (report), a pass
down (solve). Without further words each gets the same slice of the cycle; the rest is left as a
margin before the next tick of the plant. A run may instead state for each tier when its last word
of the cycle must be out: the central controller's and the supervisors' setpoints, the direct
controllers' commands. The stages before the central controller's last word then share the time up
to it, and the plant waits for commands until halfway between the last deadline and its next tick.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from bus_schemas.tree import CENTRAL, PLANT, ControlTree, depth

USED_SHARE: Final = 0.9
"""Share of the cycle by whose end the plant has its commands, or does without."""


def stage_place(agent: str, stage: str, tree: ControlTree) -> int:
    """Place of a stage in the order of one cycle: 0 for the plant's beginning.

    With h tiers below the root, requests take places 1 to h, estimates h + 1, reports and the
    central solve up to 2h + 1, setpoints up to 3h, commands 3h + 1, the plant's advance 3h + 2.
    """
    height = tree.height
    level = 0 if agent in {CENTRAL, PLANT} else depth(agent)
    places = {
        "begin": 0,
        "request": 1 + level,
        "estimate": 1 + level,
        "report": 1 + 2 * height - level,
        "solve": 1 + 2 * height + level,
        "actuate": 1 + 2 * height + level,
        "advance": 2 + 3 * height,
    }
    return places[stage]


@dataclass(frozen=True)
class Deadlines:
    """The deadlines of a run's stages.

    Parameters
    ----------
    tree
        The control tree.
    cycle_ns
        Length of a cycle on the wall clock.
    tiers_ns
        Deadline of each tier's last word, the central controller's first and the direct
        controllers' last. Empty: each stage has the same share of the cycle.
    """

    tree: ControlTree
    cycle_ns: int
    tiers_ns: tuple[int, ...] = ()

    def deadline_ns(self, agent: str, stage: str) -> int:
        """Return the deadline of an agent's stage after the beginning of its cycle [ns]."""
        place = stage_place(agent, stage, self.tree)
        if self._is_shared(place):
            return self._shared_ns(place)
        return self._by_tier_ns(agent, stage)

    def slice_ns(self, agent: str, stage: str) -> int:
        """Return a stage's slice of the cycle [ns]: its time once those before it have spoken.

        It begins at the deadline of the stage before it, which those that it waits for must keep,
        and ends at its own. Before the plant's beginning there is none: it has as much as the stage
        after it.
        """
        place = max(stage_place(agent, stage, self.tree), 1)
        if self._is_shared(place):
            return self._shared_ns(place) - self._shared_ns(place - 1)
        before_ns = self.tiers_ns[-1 if agent == PLANT else depth(agent) - 1]
        return self._by_tier_ns(agent, stage) - before_ns

    def _is_shared(self, place: int) -> bool:
        """Whether a place is among those that share a stretch of the cycle evenly."""
        return not self.tiers_ns or place <= stage_place(CENTRAL, "solve", self.tree)

    def _shared_ns(self, place: int) -> int:
        if self.tiers_ns:
            return self.tiers_ns[0] * place // stage_place(CENTRAL, "solve", self.tree)
        places = stage_place(PLANT, "advance", self.tree)
        return round(USED_SHARE * place / places * self.cycle_ns)

    def _by_tier_ns(self, agent: str, stage: str) -> int:
        """Return the deadline of a stage after the central controller's last word."""
        if agent == PLANT:
            return (self.tiers_ns[-1] + self.cycle_ns) // 2
        # A direct controller may hang from any tier: its deadline is that of its like.
        return self.tiers_ns[-1] if stage == "actuate" else self.tiers_ns[depth(agent)]
