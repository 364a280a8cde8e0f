"""Names messages of external agents whose numbers cannot be right.

Agents treat such a message as missing and do not complain, so the recorder names the device.
"""

from __future__ import annotations

from math import isfinite

from agents.plan import START_WITHIN_NS, RunPlan
from bus_schemas.bounds import LARGEST, METER_TOLERANCE, Bound, bounds_of, is_within
from bus_schemas.messages import Dispatch, Message, Production, Run, Telemetry
from bus_schemas.signals import Port

_FINITE = {
    *("power_kw", "plant_rating_kw", "commitment_kw", "regulation_kw"),
    *("dispatch_kw", "available_kw", "delivered_kw"),
}
"""Fields of a dispatch and of a production that have no other bound."""


def out_of_range(plan: RunPlan, port: Port[Message], message: Message, heard_ns: int) -> str:
    """Say what cannot be right in a message that came at a monotonic time; empty: nothing."""
    begins_ns = plan.timing.sim_time_ns(message.cycle)
    if message.sim_time_ns != begins_ns:
        cycle = message.cycle
        return f"sim_time_ns: expected {begins_ns} in cycle {cycle}, got {message.sim_time_ns}"
    if isinstance(message, Run):
        return _wrong_start(plan, message, heard_ns)
    if isinstance(message, Production):
        count = len(plan.inverters)
        for field in ("inverter_mpp_kw", "inverter_power_kw"):
            powers_kw = getattr(message, field)
            if len(powers_kw) != count or not all(map(isfinite, powers_kw)):
                return f"{field}: expected {count} finite numbers"
    for bound in _bounds(plan, port, message):
        if not is_within(message, (bound,)):
            return f"{bound.field}: expected {bound}, got {getattr(message, bound.field):.10g}"
    return ""


def _bounds(plan: RunPlan, port: Port[Message], message: Message) -> tuple[Bound, ...]:
    """Return the lowest and highest numbers that the fields of a message can hold."""
    if isinstance(message, Dispatch | Production):
        # A dispatch beyond the ratings is an operator's mistake: it is limited and acted on.
        fields = [field for field in type(message).__struct_fields__ if field in _FINITE]
        return tuple(Bound(field, -LARGEST, LARGEST) for field in fields)
    rating_kw = plan.tree.rating_kw(port.node)
    if isinstance(message, Telemetry):  # The bounds that the IMPP estimate applies.
        most_kw = rating_kw * (1.0 + METER_TOLERANCE)
        return Bound("power_kw", 0.0, most_kw), Bound("alpha", 0.0, 1.0)
    return bounds_of(type(message), rating_kw)


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
