"""The plant as one SunSpec unit, for a SCADA master that gives it orders over Modbus.

What the master writes to model 704 becomes an order to the plant, through the socket in the run's
folder. What it reads there is what is in force: an order that is over, refused or replaced by one
of another source is no longer enabled. A process of its own beside the run:
`python -m sunspec.plant_unit ADDRESS FOLDER`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import ceil
from pathlib import Path
from threading import Lock, Thread
from typing import Annotated, Any, Final

import msgspec
from msgspec import Meta
from msgspec.structs import replace

from agents.plan import RunPlan
from agents.plan_file import load_plan
from bus_schemas.errors import FailureError, InputError
from bus_schemas.tree import ROOT
from sim_plant.order_desk import FromPlant, OrderLine, PlantStatus, Reply
from sim_plant.orders import MODBUS, is_ordered
from sunspec.addresses import parse_address
from sunspec.registers import (
    Points,
    Registers,
    common_points,
    meter_points,
    operating_points,
    rating_points,
)
from sunspec.server import in_thread, listening
from sunspec.simulated import LIMIT_704, Percent, RevertS

_CONNECT_S: Final = 120.0
_WRITABLE: Final = {
    704: {
        **LIMIT_704,
        "WSetEna": "set_enabled",
        "WSetMod": "set_in_w",
        "WSet": "set_w",
        "WSetRvrtTms": "set_revert_s",
        "WRmp": "ramp_percent_per_s",
    }
}
"""What a master may write, with the fields of `UnitSettings`."""

_IN_WATTS: Final = {"set_enabled", "set_in_w", "set_w", "set_revert_s", "ramp_percent_per_s"}
_IN_PERCENT: Final = {"enabled", "percent", "revert_s", "ramp_percent_per_s"}
"""The fields that an order consists of, given as a power or as a share of the rating."""


class UnitSettings(msgspec.Struct, frozen=True):
    """What a master has written: a power in W, or a limit in % of the rating.

    The revert times are those after which the schedule returns, unless the master writes again; 0:
    never. `ramp_percent_per_s` is 0 for none.
    """

    enabled: bool = False
    percent: Percent = 100.0
    revert_s: RevertS = 0
    set_enabled: bool = False
    set_in_w: Annotated[int, Meta(ge=1, le=1)] = 1
    set_w: Annotated[float, Meta(ge=0.0)] = 0.0
    set_revert_s: RevertS = 0
    ramp_percent_per_s: Annotated[int, Meta(ge=0, le=1_000)] = 0

    @property
    def is_enabled(self) -> bool:
        return self.enabled or self.set_enabled

    def disabled(self) -> UnitSettings:
        return replace(self, enabled=False, set_enabled=False)

    def with_written(self, written: dict[str, Any]) -> UnitSettings:
        """Return them with what a master has written. Raises ValidationError: out of range.

        Of the two ways to state a power, the one that was enabled last is in force.
        """
        found = msgspec.convert(msgspec.structs.asdict(self) | written, UnitSettings, strict=False)
        if found.enabled and found.set_enabled:
            in_watts = written.get("set_enabled", False)
            return replace(found, enabled=not in_watts, set_enabled=bool(in_watts))
        return found

    def asked(self, rating_kw: float) -> dict[str, float | None]:
        """Return the fields of the order that they mean."""
        power_kw, hold_s = None, 0
        if self.set_enabled:
            power_kw, hold_s = self.set_w / 1e3, self.set_revert_s
        elif self.enabled:
            power_kw, hold_s = self.percent / 100.0 * rating_kw, self.revert_s
        ramp = self.ramp_percent_per_s * 60.0 / 100.0 * rating_kw
        return {
            "power_kw": power_kw,
            "ramp_kw_per_min": ramp or None,
            "hold_s": hold_s or None,
            "renew_s": hold_s / 2.0 or None,
        }


class PlantUnit:
    """What the plant's unit holds, between the run's socket and the masters."""

    def __init__(self, plan: RunPlan, folder: Path) -> None:
        self._folder, self._name = folder, plan.plant
        self._rating_kw, self._cycle_s = plan.tree.rating_kw(ROOT), plan.timing.cycle_s
        self._settings = UnitSettings()
        self._status: PlantStatus | None = None
        self._energy_kwh = 0.0
        self._line: OrderLine | None = None
        self._unanswered = 0
        self._lock = Lock()

    def follow(self) -> None:
        """Follow the plant until the run is over."""
        until = time.monotonic() + _CONNECT_S
        while self._line is None and time.monotonic() < until:
            try:
                self._line = OrderLine(self._folder)
            except InputError:  # The plant's process is not there yet.
                time.sleep(0.1)
        while self._line is not None:
            with suppress(FailureError):  # The plant stands still; it may go on.
                for one in self._line.heard():
                    with self._lock:
                        self._hear(one)
                with self._lock:
                    self._line = None

    def _hear(self, one: FromPlant) -> None:
        if isinstance(one, Reply):
            self._unanswered -= 1
            if not self._unanswered and not one.is_in_force:
                self._settings = self._settings.disabled()
            return
        self._status = one
        self._energy_kwh += one.delivered_kw * self._cycle_s / 3600.0
        is_ours = one.dispatch.order_source == MODBUS and is_ordered(one.dispatch)
        if not self._unanswered and not is_ours:
            self._settings = self._settings.disabled()

    def points(self) -> Points:
        with self._lock:
            settings, status, rating_kw = self._settings, self._status, self._rating_kw
            rest_s = self._rest_s()
        power_kw = 0.0 if status is None else status.delivered_kw
        available_kw = 0.0 if status is None else status.available_kw
        written = {name: getattr(settings, field) for name, field in _WRITABLE[704].items()}
        return {
            **common_points("solar plant", self._name, 1),
            701: operating_points(rating_kw, power_kw, available_kw, self._energy_kwh),
            702: rating_points(rating_kw),
            203: meter_points(1e3 * power_kw, self._energy_kwh, rating_kw),
            704: {
                **{"WMaxLimPct_SF": -2, "WSet_SF": 0, **written, "WRmpRef": 1},
                "WMaxLimPctRvrtRem": rest_s if settings.enabled else 0,
                "WSetRvrtRem": rest_s if settings.set_enabled else 0,
            },
        }

    def _rest_s(self) -> int:
        """Return the time until the schedule returns [s]; 0: it does not."""
        settings = self._settings
        hold_s = settings.set_revert_s if settings.set_enabled else settings.revert_s
        if self._unanswered or self._status is None:
            return hold_s
        dispatch = self._status.dispatch
        age_s = (dispatch.cycle - dispatch.order_renewed) * self._cycle_s
        return max(ceil((dispatch.order_hold_s or 0.0) - age_s), 0)

    def write(self, model: int, written: dict[str, Any]) -> None:
        """Take what a master writes.

        To write a set point or its `Ena` is an order while that is enabled; ramp and revert time
        change an order that is in force, and otherwise wait for the next one. `Ena` 0 ends it.

        Raises ValidationError: A value is out of range. Raises FailureError: There is no plant.
        """
        with self._lock:
            last, settings = self._settings, self._settings.with_written(written)
            if settings.set_w > 1e3 * self._rating_kw:
                raise msgspec.ValidationError(f"WSet: expected up to {self._rating_kw:g} kW")
            if self._line is None or self._status is None:
                raise FailureError("the run has not begun, or is over")
            fields = _IN_WATTS if settings.set_enabled else _IN_PERCENT
            is_changed = settings.is_enabled and not fields.isdisjoint(written)
            if is_changed or (last.is_enabled and not settings.is_enabled):
                self._line.give(MODBUS, **settings.asked(self._rating_kw))
                self._unanswered += 1
            self._settings = settings


@contextmanager
def served_unit(plan: RunPlan, folder: Path, address: str) -> Iterator[str]:
    """Serve the plant of a run in a folder as a Modbus unit; gives its address."""
    host, port, unit = parse_address(address, "--operator")
    plant = PlantUnit(plan, folder)
    device = Registers(unit, plant.points, plant.write, _WRITABLE).device
    Thread(target=plant.follow, daemon=True).start()
    with in_thread(listening({"plant": device}, host, port)) as addresses:
        yield addresses["plant"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("address", help="where to listen: modbus://127.0.0.1:5030")
    parser.add_argument("folder", type=Path, help="of the run")
    options = parser.parse_args()
    try:
        plan = load_plan(options.folder / "plan.json")
        with served_unit(plan, options.folder, options.address):
            sys.stdout.write("\n")
            sys.stdout.flush()
            sys.stdin.read()
    except InputError as error:
        known = error.renamed("--operator") if error.field == "--address" else error
        sys.stdout.write(f"{known}\n")


if __name__ == "__main__":
    main()
