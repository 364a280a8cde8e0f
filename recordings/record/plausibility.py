"""Names messages of external agents with numbers out of range.

Agents treat such a message as missing and do not complain, so the recorder names the device.
"""

from __future__ import annotations

from math import isfinite

from agents.plan import RunPlan
from agents.plan_parts import START_WITHIN_NS
from bus_schemas.bounds import METER_TOLERANCE, Bound, bounds_at, is_within
from bus_schemas.messages import Dispatch, Message, Production, Run, Telemetry
from bus_schemas.signals import Port


def out_of_range(plan: RunPlan, port: Port[Message], message: Message, heard_ns: int) -> str:
    """Name the number of a message that is out of range; `heard_ns`: when it came, monotonic."""
    begins_ns = plan.timing.sim_time_ns(message.cycle)
    if message.sim_time_ns != begins_ns:
        cycle = message.cycle
        return f"sim_time_ns: expected {begins_ns} in cycle {cycle}, got {message.sim_time_ns}"
    if isinstance(message, Run):
        return _wrong_start(plan, message, heard_ns)
    if isinstance(message, Dispatch | Production):
        return _not_finite(plan, message)
    bounds = bounds_at(type(message), plan.tree, port.node)
    if isinstance(message, Telemetry):  # The bounds that the IMPP estimate applies.
        most_kw = plan.tree.rating_kw(port.node) * (1.0 + METER_TOLERANCE)
        least_kw = -most_kw if plan.tree.is_storage(port.node) else 0.0
        bounds = Bound("power_kw", least_kw, most_kw), Bound("alpha", 0.0, 1.0)
    for bound in bounds:
        if not is_within(message, (bound,)):
            return f"{bound.field}: expected {bound}, got {getattr(message, bound.field):.10g}"
    return ""


def _not_finite(plan: RunPlan, message: Dispatch | Production) -> str:
    """Name a number that is not finite, or a list that is not of this plant.

    A dispatch beyond the ratings is an operator's mistake: it is limited and acted on.
    """
    for field in message.__struct_fields__:
        value = getattr(message, field)
        if isinstance(value, float) and not isfinite(value):
            return f"{field}: expected a finite number, got {value}"
        if field.startswith("inverter_"):
            count = len(plan.inverters)
            if len(value) != count or not all(map(isfinite, value)):
                return f"{field}: expected {count} finite numbers"
    return ""


def _wrong_start(plan: RunPlan, run: Run, heard_ns: int) -> str:
    right = {"protocol": plan.protocol}
    if run.state == "start":
        right |= {"cycle": 0, "cycle_wall_ns": plan.timing.cycle_wall_ns}
    for field, expected in right.items():
        if getattr(run, field) != expected:
            return f"{field}: expected {expected}, got {getattr(run, field)}"
    if run.state == "start" and not plan.timing.is_on_clock(run.start_time_ns, heard_ns):
        return (
            f"start_time_ns: expected within {START_WITHIN_NS / 1e9:g} s of this host's monotonic "
            f"clock ({heard_ns}), got {run.start_time_ns}"
        )
    return ""
