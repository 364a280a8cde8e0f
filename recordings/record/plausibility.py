"""What numbers a message can have: with what lies beyond, those who listen do without.

Most of it counts as silence with them, and of `run` they take what can be. Agents do not complain.
So that a device which sends such numbers can be named, whoever hears all of the bus looks at them
here.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite

from agents.plan import START_WITHIN_NS, RunPlan
from bus_schemas.bounds import METER_TOLERANCE, Bound, bounds_of
from bus_schemas.messages import Dispatch, Message, Production, Run, Telemetry
from bus_schemas.signals import Port
from bus_schemas.tree import ROOT


def absurdities(
    plan: RunPlan, port: Port[Message], message: Message, heard_ns: int
) -> dict[str, str]:
    """Say what cannot be right in a message: by field, in words. Empty: nothing.

    Parameters
    ----------
    plan
        Of the run: gives the ratings, and the simulated time of each cycle.
    port, message
        The message and where it came.
    heard_ns
        When it came, on the monotonic clock of the host.
    """
    sim_time_ns = plan.sim_time_ns(message.cycle)
    found = {}
    if message.sim_time_ns != sim_time_ns:
        found["sim_time_ns"] = (
            f"sim_time_ns is {message.sim_time_ns}, cycle {message.cycle} begins at {sim_time_ns}"
        )
    if isinstance(message, Production):
        return found | _absurd_production(len(plan.inverters), message)
    if isinstance(message, Run):
        return found | _absurd_start(plan, message, heard_ns)
    if isinstance(message, Dispatch):
        # What is beyond the ratings is held between them, and acted on: an operator's mistake.
        return found | _not_finite(message)
    for field, value, low, high in _out_of_bounds(plan.tree.rating_kw(port.node or ROOT), message):
        least = "above 0" if low == 5e-324 else f"{low:.10g}"
        found[field] = f"{field} is {value:.10g}, expected {least} to {high:.10g}"
    return found


def _out_of_bounds(rating_kw: float, message: Message) -> Iterator[tuple[str, float, float, float]]:
    """Yield field, value, lowest and highest value of each number that is out of its bounds."""
    bounds = bounds_of(type(message), rating_kw)
    if isinstance(message, Telemetry):  # The estimate judges it; this says what it refuses.
        most_kw = rating_kw * (1.0 + METER_TOLERANCE)
        bounds = (Bound("power_kw", 0.0, most_kw), Bound("alpha", 0.0, 1.0))
    for field, low, high in bounds:
        value = getattr(message, field)
        if not low <= value <= high:
            yield field, value, low, high


def _absurd_production(inverters: int, message: Production) -> dict[str, str]:
    found = _not_finite(message)
    for field in ("inverter_mpp_kw", "inverter_power_kw"):
        entries = len(getattr(message, field))
        if entries != inverters:
            found[field] = (
                f"{field} has {entries} entries, expected one for each of {inverters} inverters"
            )
    return found


def _absurd_start(plan: RunPlan, run: Run, heard_ns: int) -> dict[str, str]:
    found: dict[str, str] = {}
    if run.state != "start":
        return found
    if run.cycle != 0:
        found["cycle"] = f"the run begins with cycle {run.cycle}, expected 0"
    if run.cycle_wall_ns != plan.cycle_wall_ns:
        found["cycle_wall_ns"] = (
            f"cycle_wall_ns is {run.cycle_wall_ns}, expected {plan.cycle_wall_ns}"
        )
    if not plan.lockstep and abs(run.start_time_ns - heard_ns) > START_WITHIN_NS:
        within_s = START_WITHIN_NS / 1e9
        found["start_time_ns"] = (
            f"start_time_ns is {run.start_time_ns} and came at {heard_ns} of this host's "
            f"monotonic clock, expected within {within_s:g} s of it"
        )
    return found


def _not_finite(message: Message) -> dict[str, str]:
    found = {}
    for field in message.__struct_fields__:
        values = getattr(message, field)
        for value in values if isinstance(values, tuple) else (values,):
            if isinstance(value, float) and not isfinite(value):
                found[field] = f"{field} is {value:g}, expected finite numbers"
    return found
