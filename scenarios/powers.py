"""Powers and ramps in the user's words.

power     2MW  1500kW  0kW  250W        units W, kW, MW, GW
ramp      500kW/min  2MW/min  10kW/s    per s, min or h
"""

from __future__ import annotations

import re
from typing import Final

from bus_schemas.errors import InputError

_UNITS_KW: Final = {"W": 1e-3, "kW": 1.0, "MW": 1e3, "GW": 1e6}
_PER_MIN: Final = {"s": 60.0, "min": 1.0, "h": 1.0 / 60.0}
_POWER: Final = re.compile(r"(-?\d+(?:\.\d+)?)(W|kW|MW|GW)")
_RAMP: Final = re.compile(rf"{_POWER.pattern}/(s|min|h)")


def parse_power_kw(text: str, where: str, rating_kw: float) -> float:
    """Return a power from 0 to the rating of the plant [kW]."""
    found = _POWER.fullmatch(text)
    power_kw = float(found[1]) * _UNITS_KW[found[2]] if found else -1.0
    if not 0.0 <= power_kw <= rating_kw:
        expected = f"a power from 0 to the plant's rating of {rating_kw:,.10g} kW, such as 1.5MW"
        raise InputError.of(where, f"expected {expected}, got {text[:40]}")
    return power_kw


def parse_ramp_kw_per_min(text: str, where: str) -> float:
    found = _RAMP.fullmatch(text)
    ramp = float(found[1]) * _UNITS_KW[found[2]] * _PER_MIN[found[3]] if found else 0.0
    if ramp <= 0.0:
        raise InputError.of(where, f"expected a ramp above 0 such as 500kW/min, got {text[:40]}")
    return ramp
