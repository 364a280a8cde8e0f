"""What failures cost: over-delivery and shortfall against failure rate and repair time.

Every controller dies at random times, as often as the failure rate says, and is back after the
repair time. The same failures come to plants that are protected in different ways.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from itertools import product
from math import inf
from typing import Final, Literal, TypeAlias, get_args

import msgspec
import numpy as np
from msgspec.structs import replace

from agents.plan import RunPlan
from agents.settings import RestartPolicy
from bus_schemas.faults import FaultRule
from bus_schemas.tree import agent_name
from launch_scripts.launcher.simulation import RESTART_TAKES_S
from studies.campaign.study import FIRST_S, Campaign, trace_of

RATES_PER_H: Final = (1.0, 3.0, 10.0, 30.0, 100.0)
"""How often each controller fails in an hour."""

REPAIRS_S: Final = (RESTART_TAKES_S, 5.0, 30.0, 120.0, inf)
"""How long one is away: restarted by a launcher, later by hand, or never."""

Protection: TypeAlias = Literal["with standby", "default", "no ladder", "no revert", "neither"]

_LAST_VALUES_HOLD: Final = 10**9
"""Cycles. Without the ladder a node obeys the last message that it heard, however old that is."""


class Point(msgspec.Struct, frozen=True):
    """What the failures of one seed cost a plant with some protection.

    over_percent, short_percent: Energy beyond what was desired, or what the plant gives without
        failures, and below both, in % of the desired energy.
    """

    protection: Protection
    rate_per_h: float
    repair_s: float
    seed: int
    over_percent: float
    short_percent: float


Condition: TypeAlias = tuple[Protection, float, float, int]


def conditions(seeds: Sequence[int]) -> list[Condition]:
    """Return every protection with every failure rate, repair time and seed."""
    return list(product(get_args(Protection), RATES_PER_H, REPAIRS_S, seeds))


def run_under(campaign: Campaign, condition: Condition) -> Point:
    """Run a plant under random failures of all its controllers."""
    protection, rate_per_h, repair_s, seed = condition
    plan = replace(campaign.plan, restart=RestartPolicy(within_s=1e-6))  # As often as it takes.
    if protection == "with standby":
        plan = replace(plan, standby=tuple(map(agent_name, plan.tree.parents)))
    if protection in {"no ladder", "neither"}:
        plan = replace(plan, hold_cycles=_LAST_VALUES_HOLD)
    if protection in {"no revert", "neither"}:
        plan = replace(plan, revert=None, settings=())
    rules = failures(plan, rate_per_h, seed)
    trace = trace_of(plan, campaign.profile, rules, repair_s)
    healthy_kw, desired_kw = campaign.healthy_kw, trace.desired_kw
    over_kw = trace.delivered_kw - np.maximum(desired_kw, healthy_kw)
    short_kw = np.minimum(desired_kw, healthy_kw) - trace.delivered_kw
    return Point(
        *condition,
        over_percent=float(100.0 * np.maximum(over_kw, 0.0).sum() / desired_kw.sum()),
        short_percent=float(100.0 * np.maximum(short_kw, 0.0).sum() / desired_kw.sum()),
    )


def failures(plan: RunPlan, rate_per_h: float, seed: int) -> tuple[FaultRule, ...]:
    """Draw when each controller fails: the same times for every repair time and protection."""
    length_s = plan.cycles * plan.cycle_ns / 1e9
    found = []
    for node in plan.tree.nodes:
        draw = random.Random(f"{seed} {rate_per_h} {node}")
        at_s = FIRST_S + draw.expovariate(rate_per_h / 3600.0)
        while at_s < length_s:
            found.append(FaultRule(kill=agent_name(node), at=(round(at_s, 1),)))
            at_s += draw.expovariate(rate_per_h / 3600.0)
    return tuple(found)
