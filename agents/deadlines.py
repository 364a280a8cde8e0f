"""When, in real time, each stage of a cycle must close at the latest.

The stages follow one another through the tree: a pass down (request), a pass up (report), a pass
down (solve). Each gets the same slice of the cycle; the rest is left as a margin before the next
tick of the plant.
"""

from __future__ import annotations

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


def deadline_ns(agent: str, stage: str, tree: ControlTree, cycle_wall_ns: int) -> int:
    """Deadline of a stage after the beginning of its cycle [ns of the wall clock]."""
    share = USED_SHARE * stage_place(agent, stage, tree) / stage_place(PLANT, "advance", tree)
    return round(share * cycle_wall_ns)
