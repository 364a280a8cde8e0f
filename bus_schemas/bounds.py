"""Limits of the numbers in messages. A message beyond them is not used."""

from __future__ import annotations

import sys
from typing import Final, NamedTuple

from msgspec import UNSET

from bus_schemas.messages import (
    Command,
    Dispatch,
    Help,
    Impp,
    Memory,
    Message,
    Meter,
    Offer,
    Order,
    Residual,
    Setpoint,
)
from bus_schemas.tree import ControlTree

METER_TOLERANCE: Final = 0.05
"""Share of the rating by which a meter may read more than the rating."""

_ROUNDING: Final = 1.0 + 1e-9
"""Sums and shares over several tiers may exceed a rating by a rounding error."""

_ABOVE_ZERO: Final = 5e-324
_LEAST_NORMAL: Final = sys.float_info.min
LARGEST: Final = 1e30
"""Multiple of the rating up to which an operator may ask for too much: any finite number."""

_CLEAR_SKY: Final = 2.0
"""Highest power under a clear sky: modules may be larger than their inverters."""

_MEMORY: Final = 2.0
"""Largest power, also below 0, in what a central controller remembers."""

_TRIED: Final = 100.0
"""Largest root of the sum of squares of what it has tried, in 10 minutes of the shortest cycles."""


class Bound(NamedTuple):
    """A field, its lowest and its highest value."""

    field: str
    low: float
    high: float

    def __str__(self) -> str:
        if self.low <= -LARGEST and self.high >= LARGEST:
            return "a finite number"
        low = "above 0" if 0.0 < self.low < _LEAST_NORMAL else f"{self.low:.10g}"
        return f"{low} to {self.high:.10g}"


_OF_MEMORY: Final = (
    *(
        Bound(field, -_MEMORY, _MEMORY)
        for field in ("correction_kw", "error_kw", "expected_kw", "reference_kw", "lacking_kw")
    ),
    Bound("tried_kw", 0.0, _TRIED),
    Bound("helped_share", -_ROUNDING, _ROUNDING),
)

_ABILITY: Final = ("discharge_kw", "absorb_kw", "charge_kw")
_OF_STORAGE: Final = (*_ABILITY, "storage_kw")
"""Powers that the rating of the storages at or below a node bounds."""

_SIGNED: Final = (Setpoint, Command, Meter)
"""Messages whose power is negative where storages take it, and more by what they give."""

BOUNDS: Final[dict[type[Message], tuple[Bound, ...]]] = {
    Impp: (
        Bound("power_kw", 0.0, _ROUNDING),
        *(Bound(field, 0.0, _ROUNDING) for field in _ABILITY),
    ),
    Residual: (Bound("power_kw", -_ROUNDING, _ROUNDING),),
    Help: (Bound("missing_kw", 0.0, _ROUNDING),),
    Setpoint: (
        Bound("power_kw", 0.0, _ROUNDING),
        Bound("storage_kw", -_ROUNDING, _ROUNDING),
    ),
    Meter: (
        Bound("power_kw", -METER_TOLERANCE, 1.0 + METER_TOLERANCE),
        Bound("frequency_hz", 10.0, 110.0),
        *_OF_MEMORY,
    ),
    Memory: _OF_MEMORY,
    Command: (
        Bound("alpha", _ABOVE_ZERO, 1.0),
        Bound("power_kw", 0.0, _ROUNDING),
        Bound("revert_kw", 0.0, _ROUNDING),
    ),
    Offer: (Bound("share", 0.0, 2.0),),
    # An operator may ask for more than there is, or for less than nothing.
    Order: (
        Bound("power_kw", -LARGEST, LARGEST),
        Bound("ramp_kw_per_min", _ABOVE_ZERO, LARGEST),
        Bound("hold_s", _ABOVE_ZERO, LARGEST),
        Bound("renew_s", _ABOVE_ZERO, LARGEST),
    ),
    Dispatch: (
        Bound("power_kw", -LARGEST, LARGEST),
        # The rating of the plan: one in MW would make every share a thousandth.
        Bound("plant_rating_kw", 1.0 - 1e-6, 1.0 + 1e-6),
        Bound("clear_sky_kw", 0.0, _CLEAR_SKY),
    ),
}
"""Bounds by message type; those of powers are multiples of the rating of the message's node.

The estimate judges telemetry: it knows the limits of its inverter's measurements."""


def bounds_at(message_type: type[Message], tree: ControlTree, node: str) -> tuple[Bound, ...]:
    """Return the bounds of messages about a node of a tree."""
    storage_kw = tree.storage_kw(node)
    above_kw = 0.0 if tree.is_storage(node) else storage_kw
    # A plant of a fleet can give more than it may feed in.
    is_metered = message_type in {Meter, Memory}
    rating_kw = tree.inverters_kw(node) if is_metered else tree.rating_kw(node)
    return bounds_of(message_type, rating_kw, storage_kw, above_kw)


def bounds_of(
    message_type: type[Message], rating_kw: float, storage_kw: float = 0.0, above_kw: float = 0.0
) -> tuple[Bound, ...]:
    """Return the bounds of messages about a node of a rating.

    `storage_kw` is the rating of the storages at or below it, which the power may be below 0, and
    `above_kw` what it may be above the rating.
    """
    found = []
    for field, low, high in BOUNDS.get(message_type, ()):
        if field in _OF_STORAGE:
            if storage_kw:
                found.append(Bound(field, low * storage_kw, high * storage_kw))
            continue
        unit = rating_kw if field.endswith("_kw") else 1.0
        is_signed = storage_kw and field == "power_kw" and message_type in _SIGNED
        below, above = (storage_kw, above_kw) if is_signed else (0.0, 0.0)
        found.append(Bound(field, low * unit - below * _ROUNDING, high * unit + above * _ROUNDING))
    return tuple(found)


def is_within(message: Message, bounds: tuple[Bound, ...]) -> bool:
    """Whether all numbers of a message are within bounds; NaN is within none."""
    for field, low, high in bounds:
        value = getattr(message, field)
        if type(value) is tuple:
            if not all(one is None or low <= one <= high for one in value):
                return False
        elif value is not None and value is not UNSET and not low <= value <= high:
            return False
    return True
