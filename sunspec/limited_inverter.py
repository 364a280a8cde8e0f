"""An inverter under a power limit, in continuous time: delay, ramp and revert timer."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import inf
from typing import Annotated, Any, Final, Self, TypeAlias

import msgspec
from msgspec import Meta
from msgspec.structs import asdict, replace

LONGEST_REVERT_S: Final = 65_534
"""Most that the register of model 123 holds; that of 704 could hold more."""

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
RevertS: TypeAlias = Annotated[int, Meta(ge=0, le=LONGEST_REVERT_S)]

_STEP_S: Final = 1.0


class LimitSettings(msgspec.Struct, frozen=True):
    """A limit in per cent of the rating, and whether the inverter is connected.

    After `revert_s` without another limit (0: never) it goes to `revert_percent` if
    `revert_enabled`, and is released otherwise.
    """

    enabled: bool = False
    percent: Percent = 100.0
    revert_s: RevertS = 0
    revert_enabled: bool = False
    revert_percent: Percent = 100.0
    connected: bool = True

    def with_written(self, written: dict[str, Any]) -> Self:
        """Return them with what a master has written. Raises ValidationError: out of range."""
        present = asdict(self)
        return msgspec.convert(present | written, type(self), strict=False)

    @property
    def target(self) -> float:
        """Where the power limit goes [%]."""
        return self.percent if self.enabled else 100.0


class LimitedInverter:
    """An inverter that is asked what it does now, after it was moved on to that time.

    sun_kw: What the sun allows at a time.
    delay_s: Time from a limit until the inverter begins to follow it.
    ramp_percent_per_s: How fast it follows; infinite: at once.

    settings: Those written last.
    energy_kwh: Delivered up to the last `advance`.
    """

    def __init__(
        self,
        rating_kw: float,
        sun_kw: Callable[[float], float],
        delay_s: float = 0.0,
        ramp_percent_per_s: float = inf,
    ) -> None:
        self.rating_kw = rating_kw
        self.ramp_percent_per_s = ramp_percent_per_s
        self.settings = LimitSettings()
        self.energy_kwh = 0.0
        self._sun_kw = sun_kw
        self._delay_s = delay_s
        self._pending: deque[tuple[float, float]] = deque()
        self._revert_at = inf
        self._limit = self._target = 100.0
        self._at: float | None = None

    def apply(self, settings: LimitSettings, at: float, *, renews: bool = True) -> None:
        """Take new settings at a time [s]; `renews`: the revert time begins anew."""
        self.advance(at)
        self.settings = settings
        self._pending.append((at + self._delay_s, settings.target))
        if renews:
            reverts = settings.enabled and settings.revert_s > 0
            self._revert_at = at + settings.revert_s if reverts else inf

    def available_kw(self, at: float) -> float:
        """Return what it could give at a time: nothing while it is disconnected."""
        return self._sun_kw(at) if self.settings.connected else 0.0

    def revert_in_s(self, at: float) -> float:
        """Return the time until it reverts [s]; 0 if it does not."""
        return self._revert_at - at if self._revert_at < inf else 0.0

    def power_kw(self, at: float) -> float:
        return min(self.available_kw(at), self._limit / 100.0 * self.rating_kw)

    def advance(self, until: float) -> None:
        """Move on to a time [s]."""
        while (event_at := min([self._revert_at, *(at for at, _ in self._pending)])) <= until:
            self._move(event_at)
            if self._pending and self._pending[0][0] == event_at:
                self._target = self._pending.popleft()[1]
            else:
                self._revert_at = inf
                enabled, percent = self.settings.revert_enabled, self.settings.revert_percent
                self.settings = replace(self.settings, enabled=enabled, percent=percent)
                self._target = self.settings.target
                self._pending.clear()
            # Downwards from the power that it holds back, not from above.
            held = max(100.0 * self.power_kw(event_at) / self.rating_kw, self._target)
            self._limit = min(self._limit, held)
        self._move(until)

    def _move(self, until: float) -> None:
        """Follow the target and count the energy, in steps: the sky changes meanwhile."""
        at = until if self._at is None else self._at
        while at < until:
            step_s = min(until - at, _STEP_S)
            self.energy_kwh += self.power_kw(at) * step_s / 3600.0
            reach = self.ramp_percent_per_s * step_s
            self._limit = min(max(self._target, self._limit - reach), self._limit + reach)
            at += step_s
        if self.ramp_percent_per_s == inf:
            self._limit = self._target
        self._at = until
