"""Rates of a plant, as the user states them: one, several, or the highest that is clean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from bus_schemas.errors import InputError

HIGHEST_HZ: Final = 1000.0
LOWEST_HZ: Final = 1.0 / 3600.0
_AUTO_FROM_HZ: Final = 5.0

_EXPECTED: Final = "cycles a second such as 20, several such as 5,10,20, 1..200 or auto"


@dataclass(frozen=True, slots=True)
class Rates:
    """Rates to run at: those listed, or a search for the highest clean one in a range."""

    listed_hz: tuple[float, ...] = ()
    search_hz: tuple[float, float] | None = None

    @property
    def single_hz(self) -> float | None:
        """The rate, if it is one; None if this is a sweep."""
        return self.listed_hz[0] if len(self.listed_hz) == 1 else None


def cycles_per_s(rate_hz: float) -> str:
    """Say a rate: `20 cycles/s`."""
    return f"{rate_hz:.4g} cycle{'' if rate_hz == 1.0 else 's'}/s"


def parse_rates(text: str) -> Rates:
    """Read the value of `--rate`."""
    if text == "auto":
        return Rates(search_hz=(_AUTO_FROM_HZ, HIGHEST_HZ))
    if ".." in text:
        low, _, high = text.partition("..")
        search = _rate_hz(low, text), _rate_hz(high, text)
        if search[0] >= search[1]:
            raise InputError(f"--rate: expected a range from low to high, got {text}")
        return Rates(search_hz=search)
    listed = tuple(_rate_hz(part, text) for part in text.split(","))
    if len(set(listed)) < len(listed):
        raise InputError(f"--rate: expected each rate once, got {text}")
    return Rates(listed_hz=listed)


def _rate_hz(part: str, text: str) -> float:
    try:
        rate_hz = float(part)
    except ValueError:
        raise InputError(f"--rate: expected {_EXPECTED}, got {text}") from None
    if rate_hz > HIGHEST_HZ:
        raise InputError(
            f"--rate: expected at most {HIGHEST_HZ:g} cycles/s, got {text}; timers wake a process "
            "about 0.1 ms late, so a cycle below 1 ms leaves no time for its stages"
        )
    if not rate_hz >= LOWEST_HZ:
        raise InputError(f"--rate: expected at least one cycle an hour (0.000278), got {text}")
    return rate_hz
