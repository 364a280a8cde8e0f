"""Simulated devices in continuous time: an inverter under a limit, and a storage at a power.

They obey what is written to them after their delay, until their revert time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from math import inf
from typing import Annotated, Any, Final, Self, TypeAlias

import msgspec
from msgspec import Meta
from msgspec.structs import asdict, replace

from agents.control.storage import moved
from agents.settings import StorageSettings

LONGEST_REVERT_S: Final = 65_534
"""Most that the register of model 123 holds; that of 704 could hold more."""

RevertS: TypeAlias = Annotated[int, Meta(ge=0, le=LONGEST_REVERT_S)]

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

SET_POINTS: Final = {
    704: {
        "WSetEna": "enabled",
        "WSetMod": "in_watts",
        "WSet": "watts",
        "WSetRvrt": "revert_watts",
        "WSetEnaRvrt": "revert_enabled",
        "WSetRvrtTms": "revert_s",
    }
}
"""The same with the fields of `SetPoint`."""

Percent: TypeAlias = Annotated[float, Meta(ge=0.0, le=100.0)]


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

    @property
    def target(self) -> float:
        """Where the power limit goes [%]."""
        return self.percent if self.enabled else 100.0

    @property
    def reverted(self) -> Self:
        return replace(self, enabled=self.revert_enabled, percent=self.revert_percent)


class SetPoint(msgspec.Struct, frozen=True):
    """A power in W, negative to charge; it reverts to `revert_watts`, or to 0 W."""

    enabled: bool = False
    in_watts: Annotated[int, Meta(ge=1, le=1)] = 1
    watts: float = 0.0
    revert_s: RevertS = 0
    revert_enabled: bool = False
    revert_watts: float = 0.0

    @property
    def target(self) -> float:
        return self.watts if self.enabled else 0.0

    @property
    def reverted(self) -> Self:
        return replace(self, enabled=self.revert_enabled, watts=self.revert_watts)


Settings: TypeAlias = LimitSettings | SetPoint

_STEP_S: Final = 1.0


class Commanded(ABC):
    """A device that is asked what it does now, after it was moved on to that time.

    delay_s: Time from a write until the device begins to follow it.

    settings: Those written last.
    energy_kwh: Delivered up to the last `advance`.
    """

    def __init__(self, rating_kw: float, settings: Settings, delay_s: float) -> None:
        self.rating_kw = rating_kw
        self.settings = settings
        self.energy_kwh = 0.0
        self._delay_s = delay_s
        self._pending: deque[tuple[float, float]] = deque()
        self._revert_at = inf
        self._target = settings.target
        self._at: float | None = None

    @abstractmethod
    def power_kw(self, at: float) -> float:
        """Return what it gives at a time."""

    @abstractmethod
    def _follow(self, at: float, step_s: float) -> None:
        """Follow the target for a step."""

    @abstractmethod
    def _turn(self, at: float) -> None:
        """Turn to a new target."""

    def with_written(self, written: dict[str, Any]) -> Settings:
        """Return the settings with what a master writes. Raises ValidationError: out of range."""
        return msgspec.convert(asdict(self.settings) | written, type(self.settings), strict=False)

    def apply(self, settings: Settings, at: float, *, renews: bool = True) -> None:
        """Take new settings at a time [s]; `renews`: the revert time begins anew."""
        self.advance(at)
        self.settings = settings
        self._pending.append((at + self._delay_s, settings.target))
        if renews:
            reverts = settings.enabled and settings.revert_s > 0
            self._revert_at = at + settings.revert_s if reverts else inf

    def revert_in_s(self, at: float) -> float:
        """Return the time until it reverts [s]; 0 if it does not."""
        return self._revert_at - at if self._revert_at < inf else 0.0

    def advance(self, until: float) -> None:
        """Move on to a time [s]."""
        while (event_at := min([self._revert_at, *(at for at, _ in self._pending)])) <= until:
            self._move(event_at)
            if self._pending and self._pending[0][0] == event_at:
                self._target = self._pending.popleft()[1]
            else:
                self._revert_at = inf
                self.settings = self.settings.reverted
                self._target = self.settings.target
                self._pending.clear()
            self._turn(event_at)
        self._move(until)

    def _move(self, until: float) -> None:
        """Go on in steps: the sky changes meanwhile."""
        at = until if self._at is None else self._at
        while at < until:
            step_s = min(until - at, _STEP_S)
            self._follow(at, step_s)
            at += step_s
        self._at = until


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


class SetStorage(Commanded):
    """A storage of a scenario; it rests before the first set point."""

    def __init__(self, storage: StorageSettings) -> None:
        super().__init__(storage.rating_kw, SetPoint(), storage.delay_s)
        self.storage = storage
        self.stored_kwh = storage.state * storage.capacity_kwh
        self._power_kw = 0.0

    def power_kw(self, at: float) -> float:
        return self._power_kw

    def with_written(self, written: dict[str, Any]) -> SetPoint:
        settings = super().with_written(written)
        assert isinstance(settings, SetPoint)
        if max(abs(settings.watts), abs(settings.revert_watts)) > 1e3 * self.rating_kw:
            raise msgspec.ValidationError
        return settings

    def _turn(self, at: float) -> None:
        """Do nothing: the way to a target follows from the storage's ramp alone."""

    def _follow(self, at: float, step_s: float) -> None:
        law, wanted_kw = self.storage.law(step_s), self._target / 1e3
        self._power_kw, self.stored_kwh = moved(self.stored_kwh, self._power_kw, wanted_kw, law)
        self.energy_kwh += self._power_kw * law.cycle_h
