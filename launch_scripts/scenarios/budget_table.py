"""The table `[timing.budgets]` of a scenario: which budgets there are, and what each may say."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any, Final

import msgspec

from agents.cycle import KINDS, STAGES
from bus_schemas.signals import SIGNALS

_TIERS: Final = tuple(STAGES)
_SIGNALS: Final = tuple(signal.name for signal in SIGNALS if signal.hop_p99_ms is not None)

_BY_NAME: Final = {
    **dict.fromkeys(("decision_p99_ms", "lateness_p99_ms", "jitter_p99_ms", "age_p99_ms"), _TIERS),
    **dict.fromkeys(("cpu_percent", "resident_mb"), KINDS),
    "hop_p99_ms": _SIGNALS,
}
"""Budgets that are tables, and the names that they may have in them."""

_COUNTS: Final = (
    "missed_deadlines",
    "overruns",
    "skipped_cycles",
    "lost_messages",
    "dropped_messages",
)
_OF_THE_RUN: Final = ("loop_p99_ms", "loop_max_ms", *_COUNTS)


class BudgetTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table `[timing.budgets]` of a scenario; what it leaves out keeps its default.

    Attributes
    ----------
    loop_p99_ms, loop_max_ms
        From the plant's scheduled tick to the last command at the plant. Default of the first: half
        the cycle; the second has none.
    decision_p99_ms
        By tier (`plant`, `central`, `supervisor`, `direct`). Default: each stage's slice of the
        cycle, and the paper's upper bounds.
    lateness_p99_ms
        By tier. Default: the plant's tick, 2 % of the cycle, not below 1 ms.
    jitter_p99_ms, age_p99_ms
        By tier, for each of its stages. Default: none.
    hop_p99_ms
        By signal that completes a stage. Default: as the table of signals says.
    missed_deadlines, overruns, skipped_cycles, lost_messages
        How many in the whole run, of all tiers together. Default: 0.
    dropped_messages
        The same. Default: none.
    cpu_percent
        By tier, or of the `recorder`; of one core, for each process. Default: 80.
    resident_mb
        The same. Default: none.
    """

    loop_p99_ms: float | None = None
    loop_max_ms: float | None = None
    decision_p99_ms: dict[str, float] = {}
    lateness_p99_ms: dict[str, float] = {}
    jitter_p99_ms: dict[str, float] = {}
    age_p99_ms: dict[str, float] = {}
    hop_p99_ms: dict[str, float] = {}
    missed_deadlines: int = 0
    overruns: int = 0
    skipped_cycles: int = 0
    lost_messages: int = 0
    dropped_messages: int | None = None
    cpu_percent: dict[str, float] = {}
    resident_mb: dict[str, float] = {}


class TimingTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a run in real time is judged by.

    Attributes
    ----------
    budgets
        Upper limits by name: those of `BudgetTable`, in docs/timing.md under Budgets.

    Raises
    ------
    ValueError
        A budget, tier or signal that there is none of, or a limit that is no number above zero.
    """

    budgets: dict[str, Any] = {}

    def __post_init__(self) -> None:
        check_budgets(self.budgets)

    @property
    def stated(self) -> BudgetTable:
        """The budgets, typed."""
        return msgspec.convert(self.budgets, BudgetTable)


def check_budgets(budgets: Mapping[str, Any]) -> None:
    """Refuse budgets of what there is none of.

    Raises
    ------
    ValueError
        With what is accepted.
    """
    for name, limit in budgets.items():
        if name not in _BY_NAME:
            accepted = ", ".join(sorted({*_BY_NAME, *_OF_THE_RUN}))
            if name not in _OF_THE_RUN:
                raise ValueError(f"budgets.{name}: no such budget, accepted are {accepted}")
            _check_limit(name, limit)
            continue
        within = _BY_NAME[name]
        if not isinstance(limit, Mapping):
            raise ValueError(
                f"budgets.{name} is {limit!r}, accepted is a table such as {{ {within[0]} = 5 }}"
            )
        for key, value in limit.items():
            if key not in within:
                raise ValueError(f"budgets.{name}.{key}: accepted are {', '.join(within)}")
            _check_limit(f"{name}.{key}", value)


def _check_limit(name: str, value: object) -> None:
    counted = name in _COUNTS
    right = int if counted else int | float
    is_number = isinstance(value, right) and not isinstance(value, bool) and 0 <= value < inf
    may_be_zero = "_ms" not in name
    if not is_number or (value == 0 and not may_be_zero):
        what = "a whole number" if counted else "a number"
        lowest = "from 0 on" if may_be_zero else "above 0"
        raise ValueError(f"budgets.{name} is {value!r}, accepted is {what} {lowest}")
