"""A simulated device that obeys what is written to it: after its delay, until its revert time."""

from __future__ import annotations

from collections import deque
from math import inf
from typing import Annotated, Any, Final, Self, TypeAlias

import msgspec
from msgspec import Meta
from msgspec.structs import asdict

LONGEST_REVERT_S: Final = 65_534
"""Most that the register of model 123 holds; that of 704 could hold more."""

RevertS: TypeAlias = Annotated[int, Meta(ge=0, le=LONGEST_REVERT_S)]

_STEP_S: Final = 1.0


class Written(msgspec.Struct, frozen=True):
    """What a master has written. It reverts after `revert_s` without another write; 0: never."""

    enabled: bool = False
    revert_s: RevertS = 0

    @property
    def target(self) -> float:
        """Where the device goes."""
        raise NotImplementedError

    @property
    def reverted(self) -> Self:
        """What is in force after the revert time."""
        raise NotImplementedError


class Commanded:
    """A device that is asked what it does now, after it was moved on to that time.

    delay_s: Time from a write until the device begins to follow it.

    settings: Those written last.
    energy_kwh: Delivered up to the last `advance`.
    """

    def __init__(self, rating_kw: float, settings: Written, delay_s: float) -> None:
        self.rating_kw = rating_kw
        self.settings = settings
        self.energy_kwh = 0.0
        self._delay_s = delay_s
        self._pending: deque[tuple[float, float]] = deque()
        self._revert_at = inf
        self._target = settings.target
        self._at: float | None = None

    def power_kw(self, at: float) -> float:
        """Return what it gives at a time."""
        raise NotImplementedError

    def _follow(self, at: float, step_s: float) -> None:
        """Follow the target for a step."""
        raise NotImplementedError

    def _turn(self, at: float) -> None:
        """Turn to a new target."""

    def with_written(self, written: dict[str, Any]) -> Written:
        """Return the settings with what a master writes. Raises ValidationError: out of range."""
        return msgspec.convert(asdict(self.settings) | written, type(self.settings), strict=False)

    def apply(self, settings: Written, at: float, *, renews: bool = True) -> None:
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
