"""How often each tier acts: every m-th cycle, the tiers above more rarely than those below."""

from __future__ import annotations

from dataclasses import dataclass

from bus_schemas.errors import InputError
from bus_schemas.tree import depth


@dataclass(frozen=True)
class Periods:
    """Cycles between two turns of the parents of each tier.

    A parent gives requests and setpoints in its turns only. Between them the tiers below go on
    rebalancing against its last target. Everybody reports upwards in every cycle.

    cycles: Period of each tier that has children, the central controller's first. Each must be a
        multiple of the next.
    """

    cycles: tuple[int, ...]

    def __post_init__(self) -> None:
        for tier, period in enumerate(self.cycles):
            if period < 1:
                raise InputError(f"control.period_cycles[{tier}]: expected 1 or more, got {period}")
        for tier, (upper, lower) in enumerate(zip(self.cycles, self.cycles[1:], strict=False)):
            if upper % lower:
                raise InputError(
                    f"control.period_cycles[{tier}]: expected a multiple of that of the tier below "
                    f"it, {lower}, got {upper}"
                )

    def is_turn(self, parent: str, cycle: int) -> bool:
        """Whether a parent acts in a cycle. In arming rounds (below 0) everybody does."""
        return cycle < 0 or cycle % self.cycles[depth(parent)] == 0

    def rests_between(self, parent: str) -> bool:
        """Whether a parent's children act between its turns."""
        own = depth(parent)
        below = self.cycles[own + 1] if own + 1 < len(self.cycles) else 1
        return self.cycles[own] > below

    @property
    def longest(self) -> int:
        """The longest period in cycles: how far one agent can run ahead of another in lockstep."""
        return max(self.cycles)
