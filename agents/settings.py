"""Settings that a scenario states and the plan of a run carries."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import Meta

Scheme: TypeAlias = Literal["paper", "predictive"]
"""`paper`: the IMPP is the last cycle's (eq. 1). `predictive`: it is a forecast of this cycle's."""

Actuator: TypeAlias = Literal["fraction", "limit"]
"""`fraction`: P = alpha x MPP, as in the paper. `limit`: P = min(limit, MPP), as real inverters."""


class RestartPolicy(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the launcher does when a controller's process ends before the run does.

    when: `never`: it is given up. `on-failure`: the process is restarted. `always`: the same,
        without a limit. Default: `on-failure` in real time, `never` in lockstep.
    most: Largest number of restarts of one process within `within_s`; then it is given up.
    within_s: Time in which the restarts of a process are counted [s].
    backoff_s: Wait before the second restart within that time, doubled each time [s].
    frozen_s: A process that does not beat for this time is killed [s].
    """

    when: Literal["never", "on-failure", "always"] | None = None
    most: Annotated[int, Meta(ge=1, le=1000)] = 5
    within_s: Annotated[float, Meta(gt=0.0, le=1e6)] = 60.0
    backoff_s: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.5
    frozen_s: Annotated[float, Meta(gt=0.0, le=1e6)] = 5.0

    def wait_s(self, earlier_s: Iterable[float], now_s: float) -> float | None:
        """Return how long to wait before one more restart of a process; None: there is none.

        `earlier_s` are the times at which it was started again.
        """
        recent = sum(now_s - at_s < self.within_s for at_s in earlier_s)
        if self.when == "never" or (recent >= self.most and self.when != "always"):
            return None
        return min(self.backoff_s * 2.0 ** (recent - 1), self.within_s) if recent else 0.0


Ramp: TypeAlias = Annotated[float, Meta(gt=0.0, le=1e6)]
Delay: TypeAlias = Annotated[float, Meta(ge=0.0, le=600.0)]


class Revert(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What an inverter does without new commands (SunSpec models 123 and 704).

    after_s: Time after the last command [s].
    to: `share`: its own share of the last dispatch that its controller heard. `release`: no
        limit. A number: this share of its rating.
    """

    after_s: Annotated[float, Meta(gt=0.0, le=86_400.0)] = 60.0
    to: Literal["share", "release"] | Annotated[float, Meta(ge=0.0, le=1.0)] = "share"


class InverterSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How some inverters follow commands. Fields that are not given are as for all others.

    nodes: Which: `c1/inv07`, or a pattern such as `c1/*`.
    revert: What these inverters do without new commands.
    ramp_percent_per_s: Largest change of power, in % of the rating per second.
    delay_s: Time until a command takes effect [s].
    """

    nodes: str = "*"
    revert: Revert | None = None
    ramp_percent_per_s: Ramp | None = None
    delay_s: Delay | None = None
