"""A monotonic clock that goes when it is told to: what depends on time is worked out exactly."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class ClockByHand:
    """Called, it tells the time.

    Attributes
    ----------
    now_ns
        The time; it may be set.
    """

    now_ns: int = 5_000_000_000

    def __call__(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        """Let time pass: what would wait goes on at once."""
        self.now_ns += round(max(seconds, 0.0) * 1e9)
