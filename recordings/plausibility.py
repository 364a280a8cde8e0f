"""What numbers a message can have: what lies beyond counts as silence with those who listen.

Agents do not complain of such numbers, they do without. So that a device which sends them can be
named, whoever hears all of the bus looks at them here.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, isfinite

from agents.control.impp import METER_TOLERANCE
from agents.plan import RunPlan
from bus_schemas.messages import (
    Command,
    Dispatch,
    Help,
    Impp,
    Message,
    Production,
    Request,
    Residual,
    Setpoint,
    Telemetry,
)
from bus_schemas.signals import Port
from bus_schemas.tree import ROOT

_ROUNDING = 1.0 + 1e-9
"""Shares and sums that were worked out tier by tier may exceed a rating by a rounding error."""


def absurdity(plan: RunPlan, port: Port[Message], message: Message) -> str:
    """Say what cannot be right in a message, empty if nothing.

    Parameters
    ----------
    plan
        Of the run: gives the ratings, and the simulated time of each cycle.
    port, message
        The message and where it came.
    """
    sim_time_ns = plan.sim_time_ns(message.cycle)
    if message.sim_time_ns != sim_time_ns:
        return (
            f"sim_time_ns is {message.sim_time_ns}, cycle {message.cycle} begins at {sim_time_ns}"
        )
    if isinstance(message, Production):
        return _absurd_production(len(plan.inverters), message)
    for field, value, low, high in _bounds(plan.tree.rating_kw(port.node or ROOT), message):
        if not low <= value <= high:  # NaN fails every comparison.
            return f"{field} is {value:g}, accepted is {low:g} to {high:g}"
    return ""


def _bounds(rating_kw: float, message: Message) -> Iterator[tuple[str, float, float, float]]:
    """Yield each number of a message with its name, its lowest and its highest value."""
    most_kw = rating_kw * _ROUNDING
    least_alpha = 5e-324  # Above zero.
    match message:
        case Telemetry():
            yield "power_kw", message.power_kw, 0.0, rating_kw * (1.0 + METER_TOLERANCE)
            yield "alpha", message.alpha, least_alpha, 1.0
            yield "limit_kw", message.limit_kw, 0.0, most_kw
        case Dispatch():
            yield "power_kw", message.power_kw, 0.0, most_kw
            yield "regulation_kw", message.regulation_kw, -most_kw, most_kw
        case Request() | Setpoint():
            yield "power_kw", message.power_kw, 0.0, most_kw
        case Impp():
            yield "power_kw", message.power_kw, 0.0, most_kw
            yield "stale_cycles", message.stale_cycles, 0, inf
        case Residual():
            yield "power_kw", message.power_kw, -most_kw, most_kw
        case Help():
            yield "missing_kw", message.missing_kw, 0.0, most_kw
        case Command():
            yield "alpha", message.alpha, least_alpha, 1.0
            yield "power_kw", message.power_kw, 0.0, most_kw


def _absurd_production(inverters: int, message: Production) -> str:
    for field in ("inverter_mpp_kw", "inverter_power_kw"):
        if len(getattr(message, field)) != inverters:
            found = len(getattr(message, field))
            return f"{field} has {found} entries, accepted is one for each of {inverters} inverters"
    for field in message.__struct_fields__:
        values = getattr(message, field)
        for value in values if isinstance(values, tuple) else (values,):
            if isinstance(value, float) and not isfinite(value):
                return f"{field} has {value:g}, accepted are finite numbers"
    return ""
