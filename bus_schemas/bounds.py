"""Which numbers a message can have. A message with a number out of bounds is not used."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import Final, NamedTuple

from bus_schemas.messages import Command, Dispatch, Help, Impp, Message, Meter, Residual, Setpoint

METER_TOLERANCE: Final = 0.05
"""Share of the rating by which a meter may read more than the rating."""

_ROUNDING: Final = 1.0 + 1e-9
"""Sums and shares over several tiers may exceed a rating by a rounding error."""

_ABOVE_ZERO: Final = 5e-324


class Bound(NamedTuple):
    """A field and its lowest and highest value: multiples of the node's rating for powers."""

    field: str
    low: float
    high: float


BOUNDS: Final[dict[type[Message], tuple[Bound, ...]]] = {
    Impp: (Bound("power_kw", 0.0, _ROUNDING),),
    Residual: (Bound("power_kw", -_ROUNDING, _ROUNDING),),
    Help: (Bound("missing_kw", 0.0, _ROUNDING),),
    Setpoint: (Bound("power_kw", 0.0, _ROUNDING),),
    Meter: (Bound("power_kw", 0.0, 1.0 + METER_TOLERANCE),),
    Command: (Bound("alpha", _ABOVE_ZERO, 1.0), Bound("power_kw", 0.0, _ROUNDING)),
    # An operator may ask for more than there is, or for less than nothing: it must be a number. And
    # everybody's share of it must be one.
    Dispatch: (Bound("power_kw", -inf, inf), Bound("plant_rating_kw", 1e-3, 1e3)),
}
"""Telemetry is judged by the estimate, which knows what its inverter can have measured."""


def is_plausible(message: Message, rating_kw: float) -> bool:
    """Whether all numbers of a message are within their bounds."""
    for field, low, high in BOUNDS.get(type(message), ()):
        value = getattr(message, field)
        if not _is_within(value, low, high, rating_kw if field.endswith("_kw") else 1.0):
            return False
    return True


def out_of_bounds(message: Message, rating_kw: float) -> Iterator[tuple[str, float, float, float]]:
    """Yield field, value, lowest and highest value of each number that is out of its bounds."""
    for field, low, high in BOUNDS.get(type(message), ()):
        value = getattr(message, field)
        scale = rating_kw if field.endswith("_kw") else 1.0
        if not _is_within(value, low, high, scale):
            yield field, value, low * scale, high * scale


def _is_within(value: float, low: float, high: float, scale: float) -> bool:
    # NaN fails every comparison, an infinite value its own.
    return low * scale <= value <= high * scale and -inf < value < inf
