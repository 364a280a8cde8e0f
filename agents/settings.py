"""Settings that a scenario states and the plan of a run carries."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf
from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import Meta

from agents.control.grid import GridLaw
from agents.control.offers import SAMPLE_S, WINDOW_S, OfferSettings
from agents.control.storage import StorageLaw
from bus_schemas.errors import InputError

Scheme: TypeAlias = Literal["paper", "predictive"]
"""`paper`: the IMPP is the last cycle's (eq. 1). `predictive`: it is a forecast of this cycle's."""

Actuator: TypeAlias = Literal["fraction", "limit"]
"""`fraction`: P = alpha x MPP, as in the paper. `limit`: P = min(limit, MPP), as real inverters."""

StorageHelp: TypeAlias = Literal["last", "first"]
"""`last`: what inverters cannot give. `first`: also what they could give, until they do."""

_MOST_DOUBLINGS = 60
"""Of a wait; any such wait is longer than `within_s` allows."""


class RestartPolicy(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the launcher does when a controller's process ends before the run does.

    when: When a process is restarted; `always` has no limit. Default: `on-failure` in real time,
        `never` in lockstep.
    most: Restarts of a process within `within_s`; after that it is given up.
    within_s: Time in which restarts are counted [s].
    backoff_s: Wait before the second restart in that time, doubled each time [s].
    frozen_s: A process without a beat for this time is killed [s].
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
        doublings = min(recent - 1, _MOST_DOUBLINGS)
        return min(self.backoff_s * 2.0**doublings, self.within_s) if recent else 0.0


OfClearSky: TypeAlias = Annotated[float, Meta(gt=0.0, le=1.2)]
Ramp: TypeAlias = Annotated[float, Meta(gt=0.0, le=1e6)]
Delay: TypeAlias = Annotated[float, Meta(ge=0.0, le=600.0)]
State: TypeAlias = Annotated[float, Meta(ge=0.0, le=1.0)]
Efficiency: TypeAlias = Annotated[float, Meta(gt=0.0, le=1.0)]


class Revert(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What an inverter does without new commands (SunSpec models 123 and 704).

    after_s: Time after the last command [s].
    to: Its `share` of the last dispatch that its controller heard, no limit (`release`), or a share
        of its rating.
    """

    after_s: Annotated[float, Meta(gt=0.0, le=86_400.0)] = 60.0
    to: Literal["share", "release"] | Annotated[float, Meta(ge=0.0, le=1.0)] = "share"


class InverterSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How some inverters follow commands. Fields that are not given are as for all others.

    nodes: Which: `c1/inv07`, or a pattern such as `c1/*`.
    revert: What they do without new commands.
    ramp_percent_per_s: Largest change of power, in % of the rating per second.
    delay_s: Time until a command takes effect [s].
    """

    nodes: str = "*"
    revert: Revert | None = None
    ramp_percent_per_s: Ramp | None = None
    delay_s: Delay | None = None


class StorageSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A storage: a battery behind its own inverter, at a bus bar of the plant.

    name: Its name in the control tree.
    cluster: Cluster that it helps first, such as `c1`. Default: the whole plant.
    rating_kw: Largest power, given or taken [kW].
    capacity_kwh: Energy that it can hold [kWh].
    state: Its energy at the start, as a share of its capacity.
    target: State to which headroom charges it.
    lowest_state: State at which it gives nothing more.
    highest_state: State at which it takes nothing more.
    charge_efficiency: Share of the energy taken that is stored.
    discharge_efficiency: Share of the stored energy that is given.
    standing_loss_kw: Constant loss of stored energy [kW].
    delay_s: Time until a command takes effect [s].
    ramp_percent_per_s: Largest change of power, in % of the rating per second. Default: any.
    """

    name: str
    cluster: str = ""
    rating_kw: Annotated[float, Meta(gt=0.0, le=1e7)]
    capacity_kwh: Annotated[float, Meta(gt=0.0, le=1e9)]
    state: State = 0.8
    target: State = 0.8
    lowest_state: State = 0.1
    highest_state: State = 1.0
    charge_efficiency: Efficiency = 0.92
    discharge_efficiency: Efficiency = 0.92
    standing_loss_kw: Annotated[float, Meta(ge=0.0, le=1e7)] = 0.0
    delay_s: Delay = 0.0
    ramp_percent_per_s: Ramp | None = None

    def __post_init__(self) -> None:
        if not self.lowest_state < self.highest_state:
            expected = f"more than lowest_state, {self.lowest_state:g}"
            raise InputError.of("highest_state", f"expected {expected}, got {self.highest_state:g}")
        for field, value in (("state", self.state), ("target", self.target)):
            if not self.lowest_state <= value <= self.highest_state:
                expected = f"{self.lowest_state:g} to {self.highest_state:g}, its limits"
                raise InputError.of(field, f"expected {expected}, got {value:g}")

    @property
    def path(self) -> str:
        return f"{self.cluster}/{self.name}" if self.cluster else self.name

    def law(self, cycle_s: float) -> StorageLaw:
        """Return the same in cycles of a length."""
        return StorageLaw(
            rating_kw=self.rating_kw,
            ramp_kw=(self.ramp_percent_per_s or inf) / 100.0 * self.rating_kw * cycle_s,
            lowest_kwh=self.lowest_state * self.capacity_kwh,
            highest_kwh=self.highest_state * self.capacity_kwh,
            target_kwh=self.target * self.capacity_kwh,
            charge_efficiency=self.charge_efficiency,
            discharge_efficiency=self.discharge_efficiency,
            loss_kw=self.standing_loss_kw,
            cycle_h=cycle_s / 3600.0,
        )


class OfferedCommitment(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="offered",
):
    """How the central controller offers the commitment of an interval before it begins.

    The first interval begins with the run. Within an interval the commitment follows the power
    under a clear sky.

    interval_s: Length of an interval [s].
    lead_s: Time from an offer to its interval [s]. Default: 60, or the interval if that is shorter.
    reliability: Share of the intervals that lack at most 1 % of their energy.
    first_share: Share of the clear-sky power promised until the first offer.
    """

    interval_s: Annotated[float, Meta(ge=1.0, le=14400.0)] = 900.0
    lead_s: Annotated[float, Meta(gt=0.0, le=14400.0)] | None = None
    reliability: Annotated[float, Meta(ge=0.5, le=0.999)] = 0.95
    first_share: OfClearSky = 0.3

    def law(self, cycle_s: float, *, is_seen: bool) -> OfferSettings:
        """Return the same in cycles of a length; `is_seen`: see `OfferSettings`."""
        lead_s = min(60.0, self.interval_s) if self.lead_s is None else self.lead_s
        cycles, lead_cycles = round(self.interval_s / cycle_s), max(round(lead_s / cycle_s), 1)
        if abs(cycles * cycle_s - self.interval_s) > 1e-9 or cycles == 0:
            expected = f"whole cycles of {cycle_s:g} s"
            raise InputError.of(
                "commitment.interval_s", f"expected {expected}, got {self.interval_s:g}"
            )
        if lead_cycles > cycles:
            expected = f"at most interval_s, {self.interval_s:g}"
            raise InputError.of("commitment.lead_s", f"expected {expected}, got {lead_s:g}")
        sample_cycles = min(max(round(SAMPLE_S / cycle_s), 1), cycles)
        return OfferSettings(
            interval_cycles=cycles,
            lead_cycles=lead_cycles,
            sample_cycles=sample_cycles,
            window_samples=max(round(WINDOW_S / (sample_cycles * cycle_s)), 1),
            miss_rate=1.0 - self.reliability,
            first_share=self.first_share,
            is_seen=is_seen,
        )


_Limit: TypeAlias = Annotated[float, Meta(gt=0.0, le=1e12)]
_Percent: TypeAlias = Annotated[float, Meta(ge=0.0, le=20.0)]
_PerUnit: TypeAlias = Annotated[float, Meta(ge=0.0, le=1.0)]
_Gain: TypeAlias = Annotated[float, Meta(ge=0.0, le=1000.0)]


class Droop(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Frequency response by droop, with the names and the units of WECC's REPC_A.

    fdbd1: End of the deadband above the nominal frequency, per unit: -36 mHz of 60 Hz.
    fdbd2: End of the deadband below it, per unit.
    ddn: Reciprocal of the droop above it, on the plant's rating; 20: 5 %.
    dup: Reciprocal of the droop below it.
    reserve_percent: Headroom kept for the response upwards, in % of the rating.
    """

    fdbd1: Annotated[float, Meta(ge=-0.1, le=0.0)] = -0.0006
    fdbd2: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.0006
    ddn: _Gain = 20.0
    dup: _Gain = 20.0
    reserve_percent: Annotated[float, Meta(ge=0.0, le=100.0)] = 0.0


class GridSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Demands of the grid on the plant, and losses on the way to its meter.

    ramp_up_kw_per_min: Fastest rise of the plant's target [kW/min]. Default: any.
    ramp_down_kw_per_min: Fastest fall of the plant's target [kW/min]. Default: any.
    nominal_hz: Nominal frequency [Hz].
    pmin: Lowest power, per unit of the rating.
    pmax: Highest power, per unit of the rating.
    loss_constant_percent: Constant losses, in % of the rating.
    loss_quadratic_percent: Losses with the square of the power: at the rating, in % of it.
    meter_error_percent: Error of the plant's meter, in % of its reading.
    """

    ramp_up_kw_per_min: _Limit | None = None
    ramp_down_kw_per_min: _Limit | None = None
    nominal_hz: Annotated[float, Meta(ge=16.0, le=100.0)] = 60.0
    droop: Droop | None = None
    pmin: _PerUnit = 0.0
    pmax: Annotated[float, Meta(gt=0.0, le=1.0)] = 1.0
    loss_constant_percent: Annotated[float, Meta(ge=0.0, le=4.0)] = 0.0
    loss_quadratic_percent: _Percent = 0.0
    meter_error_percent: Annotated[float, Meta(ge=-4.0, le=4.0)] = 0.0

    def __post_init__(self) -> None:
        if self.pmin > self.pmax:
            raise InputError(f"expected pmin up to pmax, got {self.pmin} and {self.pmax}")

    @property
    def moves_target(self) -> bool:
        """Whether the plant is to give anything else than its dispatch."""
        ramps = self.ramp_up_kw_per_min, self.ramp_down_kw_per_min
        return (*ramps, self.droop) != (None, None, None) or (self.pmin, self.pmax) != (0.0, 1.0)

    def law(self, rating_kw: float, cycle_s: float) -> GridLaw:
        """Return what is asked of a plant of a rating and a cycle."""
        droop = self.droop or Droop(ddn=0.0, dup=0.0)
        return GridLaw(
            ramp_up_kw=(self.ramp_up_kw_per_min or inf) * cycle_s / 60.0,
            ramp_down_kw=(self.ramp_down_kw_per_min or inf) * cycle_s / 60.0,
            nominal_hz=self.nominal_hz,
            fdbd1=droop.fdbd1,
            fdbd2=droop.fdbd2,
            ddn_kw=droop.ddn * rating_kw,
            dup_kw=droop.dup * rating_kw,
            reserve_kw=droop.reserve_percent / 100.0 * rating_kw,
            pmin_kw=self.pmin * rating_kw,
            pmax_kw=self.pmax * rating_kw,
            loss_kw=self.loss_constant_percent / 100.0 * rating_kw,
            loss_per_kw=self.loss_quadratic_percent / 100.0 / rating_kw,
        )


class FleetPlant(msgspec.Struct, frozen=True, kw_only=True):
    """A plant of a fleet: a node of the first tier, with a meter of its own.

    export_limit_kw: Most that it may feed in [kW].
    grid: Its ramp limits, its losses and the error of its meter.
    """

    name: str
    export_limit_kw: float
    grid: GridSettings = GridSettings()
