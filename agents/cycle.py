"""One cycle: its stages, their places and deadlines, who acts in it. Stated here and nowhere else.

sense (plant) -> estimate (direct) -> report (supervisors, upwards)
    -> solve (central, then downwards) -> actuate (direct) -> apply (plant)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, get_args

from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from bus_schemas.tree import CENTRAL, PLANT, RECORDER, ControlTree, depth

Kind: TypeAlias = Literal["plant", "central", "supervisor", "direct", "storage", "recorder"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)

STAGES: Final[dict[Kind, tuple[str, ...]]] = {
    "plant": ("sense", "apply"),
    "central": ("solve",),
    "supervisor": ("report", "solve"),
    "direct": ("estimate", "actuate"),
    "storage": ("estimate", "actuate"),
}
"""Stages of each kind of agent, in their order."""

USED_SHARE: Final = 0.9
"""Share of the cycle by whose end the plant has its commands, or goes on without."""

_ALONE: Final[dict[str, Kind]] = {PLANT: "plant", CENTRAL: "central", RECORDER: "recorder"}

_LATER: Final = {"setpoint": "solve", "command": "actuate", "production": "apply"}
"""Stage in which a signal is published, where that is not its publisher's first one."""


def kind_of(agent: str, tree: ControlTree) -> Kind:
    if tree.is_storage(agent):
        return "storage"
    return _ALONE.get(agent) or ("direct" if tree.is_leaf(agent) else "supervisor")


def stage_place(agent: str, stage: str, tree: ControlTree) -> int:
    """Return the place of a stage in the order of a cycle. Each step is one hop on the bus."""
    level = 0 if agent in {CENTRAL, PLANT} else depth(agent)
    match stage:
        case "sense":
            return 0
        case "estimate":
            return 1
        case "report":
            return 1 + tree.height - level
        case "apply":
            return 2 + 2 * tree.height
    return 1 + tree.height + level  # The way down: solve and actuate.


def stage_of(port: Port[Message], tree: ControlTree) -> str:
    """Return the stage in which an agent publishes on a port."""
    return _LATER.get(port.signal.name) or STAGES[kind_of(port.publisher, tree)][0]


@dataclass(frozen=True)
class Deadlines:
    """When, in real time, each stage of a cycle closes at the latest.

    `USED_SHARE` of the cycle is divided into parts. The first place, in which all direct
    controllers estimate at once, has one for each tier and one more; each other place has one.

    cycle_ns: Length of a cycle on the wall clock.
    """

    tree: ControlTree
    cycle_ns: int

    def deadline_ns(self, agent: str, stage: str) -> int:
        """Return the deadline of an agent's stage after the beginning of its cycle [ns]."""
        return self._of_place(stage_place(agent, stage, self.tree))

    def slice_ns(self, agent: str, stage: str) -> int:
        """Return a stage's part of the cycle: from the deadline before its own to its own [ns]."""
        if stage == "sense":  # The plant's tick has no deadline before it.
            return self._of_place(2) - self._of_place(1)
        before_ns = self._of_place(stage_place(agent, stage, self.tree) - 1)
        return self.deadline_ns(agent, stage) - before_ns

    def room_ns(self, parent: str, stage: str) -> int:
        """Return how much later than a parent's stage its listeners' stages close [ns]."""
        place = stage_place(parent, stage, self.tree)
        return self._of_place(place + 1) - self._of_place(place)

    def _of_place(self, place: int) -> int:
        more = self.tree.height
        last = stage_place(PLANT, "apply", self.tree)
        share = (place + more) / (last + more) if place else 0.0
        return round(USED_SHARE * self.cycle_ns * share)


@dataclass(frozen=True)
class Periods:
    """How often the parents of each tier act: their periods in cycles, the central one's first.

    A parent sends setpoints only when it acts. Every agent reports upwards in every cycle.
    """

    cycles: tuple[int, ...]

    def __post_init__(self) -> None:
        below = 1
        for tier, period in reversed(list(enumerate(self.cycles))):
            if period < 1 or period % below:
                where = f"control.period_cycles[{tier}]"
                raise InputError.of(where, f"expected a positive multiple of {below}, got {period}")
            below = period

    def acts(self, parent: str, cycle: int) -> bool:
        """Whether a parent acts in a cycle. In arming rounds (below 0) all parents do."""
        return cycle < 0 or cycle % self.cycles[depth(parent)] == 0

    @property
    def longest(self) -> int:
        """The longest period: how far one agent can run ahead of another in lockstep."""
        return max(self.cycles)
