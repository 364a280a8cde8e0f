"""Plans of small runs."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
from msgspec.structs import replace

from agents.plan import RunPlan, changed
from agents.plan_parts import Access, Control, Site, Supervision, Timing

CYCLE_NS = 1_000_000_000
REAL_TIME = CYCLE_NS
"""A `cycle_wall_ns`: cycles of a second by the clock."""

_PARTS: dict[str, type[msgspec.Struct]] = {
    "timing": Timing,
    "control": Control,
    "site": Site,
    "access": Access,
    "supervision": Supervision,
}
_PART_OF = {name: part for part, kind in _PARTS.items() for name in kind.__struct_fields__}

FOUR = {"c1/a": 100.0, "c1/b": 100.0, "c2/c": 100.0, "c2/d": 100.0}


def plan_of(ratings_kw: Mapping[str, float], **changes: object) -> RunPlan:
    """Plan of a run in lockstep, from the path and rating of each inverter."""
    tiers = max(leaf.count("/") + 1 for leaf in ratings_kw)
    plan = RunPlan(
        run_id="by-hand",
        plant="oahu",
        inverters=tuple(ratings_kw.items()),
        timing=Timing(
            start_time_ns=0,
            cycle_ns=CYCLE_NS,
            cycles=1,
            timezone="UTC",
            cycle_wall_ns=0,
            stall_timeout_s=3.0,
        ),
        control=Control(
            period_cycles=(1,) * tiers,
            scheme="paper",
            actuator="fraction",
            alpha_min=0.05,
            hold_cycles=3,
            neighbourhoods=(),
        ),
    )
    return with_changes(plan, **changes)


def with_changes(plan: RunPlan, **changes: object) -> RunPlan:
    """Return a plan with other values, each by its own name: `cycles=60, faults=(rule,)`."""
    own: dict[str, object] = {}
    parts: dict[str, dict[str, object]] = {}
    for name, value in changes.items():
        if name in {"faults", "faults_seed"}:
            parts.setdefault("faults", {})["rules" if name == "faults" else "seed"] = value
        elif name in RunPlan.__struct_fields__:
            own[name] = value
        else:
            parts.setdefault(_PART_OF[name], {})[name] = value
    return replace(changed(plan, **parts), **own)


def plan_at_noon(ratings_kw: Mapping[str, float] = FOUR, **changes: object) -> RunPlan:
    """Plan of a run that begins on 2010-04-01 12:00:00 in Honolulu."""
    noon = {"start_time_ns": 1_270_159_200_000_000_000, "timezone": "Pacific/Honolulu"}
    return plan_of(ratings_kw, **(noon | changes))
