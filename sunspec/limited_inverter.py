"""An inverter under a power limit, in continuous time: delay, ramp and revert timer."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Annotated, Final, Self, TypeAlias

from msgspec import Meta
from msgspec.structs import replace

from sunspec.commanded import Commanded, Written

LIMIT_704: Final = {
    "WMaxLimPctEna": "enabled",
    "WMaxLimPct": "percent",
    "WMaxLimPctRvrtTms": "revert_s",
}
LIMIT_POINTS: Final = {
    123: {
        "Conn": "connected",
        "WMaxLim_Ena": "enabled",
        "WMaxLimPct": "percent",
        "WMaxLimPct_RvrtTms": "revert_s",
    },
    704: {
        **LIMIT_704,
        "WMaxLimPctEnaRvrt": "revert_enabled",
        "WMaxLimPctRvrt": "revert_percent",
    },
}
"""Points of SunSpec models, with the fields of `LimitSettings` that they set."""

Percent: TypeAlias = Annotated[float, Meta(ge=0.0, le=100.0)]


class LimitSettings(Written, frozen=True):
    """A limit in per cent of the rating, and whether the inverter is connected.

    It reverts to `revert_percent` if `revert_enabled`, and is released otherwise.
    """

    percent: Percent = 100.0
    revert_enabled: bool = False
    revert_percent: Percent = 100.0
    connected: bool = True

    @property
    def target(self) -> float:
        """Where the power limit goes [%]."""
        return self.percent if self.enabled else 100.0

    @property
    def reverted(self) -> Self:
        return replace(self, enabled=self.revert_enabled, percent=self.revert_percent)


class LimitedInverter(Commanded):
    """An inverter under a limit.

    sun_kw: What the sun allows at a time.
    ramp_percent_per_s: How fast it follows; infinite: at once.
    """

    settings: LimitSettings

    def __init__(
        self,
        rating_kw: float,
        sun_kw: Callable[[float], float],
        delay_s: float = 0.0,
        ramp_percent_per_s: float = inf,
    ) -> None:
        super().__init__(rating_kw, LimitSettings(), delay_s)
        self.ramp_percent_per_s = ramp_percent_per_s
        self._sun_kw = sun_kw
        self._limit = 100.0

    def available_kw(self, at: float) -> float:
        """Return what it could give at a time: nothing while it is disconnected."""
        return self._sun_kw(at) if self.settings.connected else 0.0

    def power_kw(self, at: float) -> float:
        return min(self.available_kw(at), self._limit / 100.0 * self.rating_kw)

    def _turn(self, at: float) -> None:
        if self.ramp_percent_per_s == inf:
            self._limit = self._target
        # Downwards from the power that it holds back, not from above.
        held = max(100.0 * self.power_kw(at) / self.rating_kw, self._target)
        self._limit = min(self._limit, held)

    def _follow(self, at: float, step_s: float) -> None:
        self.energy_kwh += self.power_kw(at) * step_s / 3600.0
        reach = self.ramp_percent_per_s * step_s
        self._limit = min(max(self._target, self._limit - reach), self._limit + reach)
