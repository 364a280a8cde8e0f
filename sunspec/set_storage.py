"""A storage that is given a power, in continuous time."""

from __future__ import annotations

from typing import Annotated, Any, Final, Self

import msgspec
from msgspec import Meta
from msgspec.structs import replace

from agents.control.storage import moved
from agents.settings import StorageSettings
from sunspec.commanded import Commanded, Written

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
"""Points of the SunSpec model, with the fields of `SetPoint` that they set."""


class SetPoint(Written, frozen=True):
    """A power in W, negative to charge; it reverts to `revert_watts`, or to 0 W."""

    in_watts: Annotated[int, Meta(ge=1, le=1)] = 1
    watts: float = 0.0
    revert_enabled: bool = False
    revert_watts: float = 0.0

    @property
    def target(self) -> float:
        return self.watts if self.enabled else 0.0

    @property
    def reverted(self) -> Self:
        return replace(self, enabled=self.revert_enabled, watts=self.revert_watts)


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

    def _follow(self, at: float, step_s: float) -> None:
        law, wanted_kw = self.storage.law(step_s), self._target / 1e3
        self._power_kw, self.stored_kwh = moved(self.stored_kwh, self._power_kw, wanted_kw, law)
        self.energy_kwh += self._power_kw * law.cycle_h
