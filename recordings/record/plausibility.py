"""Names messages of external agents whose numbers cannot be right.

Agents treat such a message as missing and do not complain, so the recorder names the device.
"""

from __future__ import annotations

from agents.plan import START_WITHIN_NS, RunPlan
from bus_schemas.bounds import METER_TOLERANCE, Bound, bounds_of
from bus_schemas.messages import Dispatch, Message, Production, Run, Telemetry
from bus_schemas.signals import Port

_SMALLEST = 5e-324
_LARGEST = 1.7976931348623157e308


def absurdity(plan: RunPlan, port: Port[Message], message: Message, heard_ns: int) -> str:
    """Say what cannot be right in a message that came at a monotonic time; empty: nothing."""
    begins_ns = plan.sim_time_ns(message.cycle)
    if message.sim_time_ns != begins_ns:
        cycle = message.cycle
        return f"sim_time_ns: expected {begins_ns} in cycle {cycle}, got {message.sim_time_ns}"
    if isinstance(message, Run):
        return _absurd_start(plan, message, heard_ns)
    inverters = len(plan.inverters)
    if isinstance(message, Production):
        lengths = {len(message.inverter_mpp_kw), len(message.inverter_power_kw)}
        if lengths != {inverters}:
            return f"inverter_mpp_kw, inverter_power_kw: expected {inverters} entries in each"
    for field, low, high in _bounds(plan, port, message):
        entry = getattr(message, field)
        for value in entry if isinstance(entry, tuple) else (entry,):
            if value is not None and not low <= value <= high:
                least = {_SMALLEST: "above 0", -_LARGEST: "a finite number"}.get(low, f"{low:.10g}")
                most = f" to {high:.10g}" if high < _LARGEST else ""
                return f"{field}: expected {least}{most}, got {value:.10g}"
    return ""


def _bounds(plan: RunPlan, port: Port[Message], message: Message) -> tuple[Bound, ...]:
    """Return the lowest and highest numbers that the fields of a message can hold."""
    if isinstance(message, Dispatch | Production):
        # A dispatch beyond the ratings is an operator's mistake: it is limited and acted on.
        own = set(message.__struct_fields__).difference(Message.__struct_fields__)
        return tuple(Bound(field, -_LARGEST, _LARGEST) for field in sorted(own))
    rating_kw = plan.tree.rating_kw(port.node)
    if isinstance(message, Telemetry):  # The bounds that the IMPP estimate applies.
        most_kw = rating_kw * (1.0 + METER_TOLERANCE)
        return Bound("power_kw", 0.0, most_kw), Bound("alpha", 0.0, 1.0)
    return bounds_of(type(message), rating_kw)


def _absurd_start(plan: RunPlan, run: Run, heard_ns: int) -> str:
    right = {"protocol": plan.protocol}
    if run.state == "start":
        right |= {"cycle": 0, "cycle_wall_ns": plan.cycle_wall_ns}
    for field, expected in right.items():
        if getattr(run, field) != expected:
            return f"{field}: expected {expected}, got {getattr(run, field)}"
    is_far = abs(run.start_time_ns - heard_ns) > START_WITHIN_NS
    if run.state == "start" and is_far and not plan.lockstep:
        return (
            f"start_time_ns: expected within {START_WITHIN_NS / 1e9:g} s of this host's monotonic "
            f"clock ({heard_ns}), got {run.start_time_ns}"
        )
    return ""
