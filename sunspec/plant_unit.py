"""The plant as one SunSpec unit, for a SCADA master that gives it orders over Modbus.

What the master writes to model 704 becomes an order to the plant, through the socket in the run's
folder. A process of its own beside the run: `python -m sunspec.plant_unit ADDRESS FOLDER`.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from threading import Thread
from typing import Annotated, Any, Final

import msgspec
from anyio.from_thread import start_blocking_portal
from msgspec import Meta

from agents.plan import RunPlan, load_plan
from bus_schemas.errors import InputError
from bus_schemas.tree import ROOT
from sim_plant.order_desk import OrderLine, PlantStatus
from sunspec.addresses import parse_address
from sunspec.limited_inverter import LIMIT_704, LimitedInverter, LimitSettings, RevertS
from sunspec.registers import Points, Registers, common_points, inverter_points, meter_points
from sunspec.server import listening

_CONNECT_S: Final = 120.0
_ORDER_POINTS: Final = {
    "WSetEna": "set_enabled",
    "WSetMod": "set_in_w",
    "WSet": "set_w",
    "WSetRvrtTms": "set_revert_s",
    "WRmp": "ramp_percent_per_s",
}
_WRITABLE: Final = {704: LIMIT_704 | _ORDER_POINTS}
"""What a master may write, with the fields of `UnitSettings`."""


class UnitSettings(LimitSettings, frozen=True):
    """What a master has written: a power in W, or else a limit in % of the rating.

    The revert times are those after which the schedule returns, unless the master writes again; 0:
    never. `ramp_percent_per_s` is 0 for none.
    """

    set_enabled: bool = False
    set_in_w: Annotated[int, Meta(ge=1, le=1)] = 1
    set_w: Annotated[float, Meta(ge=0.0)] = 0.0
    set_revert_s: RevertS = 0
    ramp_percent_per_s: Annotated[int, Meta(ge=0, le=1_000)] = 0

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


class PlantUnit(LimitedInverter):
    """The plant, as its status says it. It follows orders by itself, not limits."""

    def __init__(self, plan: RunPlan, folder: Path) -> None:
        super().__init__(plan.tree.rating_kw(ROOT), lambda at: 0.0)
        self.settings: UnitSettings = UnitSettings()
        self._name, self._cycle_s = plan.plant, plan.timing.cycle_s
        self._folder = folder
        self._status: PlantStatus | None = None
        self._line: OrderLine | None = None

    def power_kw(self, at: float) -> float:
        return self._status.delivered_kw if self._status is not None else 0.0

    def available_kw(self, at: float) -> float:
        return self._status.available_kw if self._status is not None else 0.0

    def follow(self) -> None:
        """Follow the plant until the run is over."""
        until = time.monotonic() + _CONNECT_S
        while self._line is None and time.monotonic() < until:
            try:
                self._line = OrderLine(self._folder)
            except InputError:  # The plant's process is not there yet.
                time.sleep(0.1)
        for status in self._line.statuses() if self._line is not None else ():
            self._status = status
            self.energy_kwh += status.delivered_kw * self._cycle_s / 3600.0

    def points(self) -> Points:
        of_inverter = inverter_points(self, 0.0)
        order = {name: getattr(self.settings, field) for name, field in _ORDER_POINTS.items()}
        return {
            **common_points("solar plant", self._name, 1),
            701: of_inverter[701],
            702: of_inverter[702],
            203: meter_points(1e3 * self.power_kw(0.0), self.energy_kwh, self.rating_kw),
            704: {"WSet_SF": 0, **of_inverter[704], **order, "WRmpRef": 1},
        }

    def write(self, model: int, written: dict[str, Any]) -> None:
        """Take what a master writes; while a power is enabled, or no longer, that is an order.

        Raises ValidationError: A value is out of range, or there is no plant yet.
        """
        settings = self.settings.with_written(written)
        if settings.set_w > 1e3 * self.rating_kw:
            raise msgspec.ValidationError(f"WSet: expected up to {self.rating_kw:g} kW")
        if self._line is None or self._status is None:
            raise msgspec.ValidationError("the run has not begun")
        last = self.settings
        if any((settings.enabled, settings.set_enabled, last.enabled, last.set_enabled)):
            self._line.give("modbus", **settings.asked(self.rating_kw))
        self.settings = settings


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("address", help="where to listen: modbus://127.0.0.1:5030")
    parser.add_argument("folder", type=Path, help="of the run")
    options = parser.parse_args()
    host, port, unit = parse_address(options.address, "--operator")
    plant = PlantUnit(load_plan(options.folder / "plan.json"), options.folder)
    device = Registers(unit, plant.points, plant.write, _WRITABLE).device
    Thread(target=plant.follow, daemon=True).start()
    try:
        with (
            start_blocking_portal() as portal,
            portal.wrap_async_context_manager(listening([{"plant": device}], host, port)),
        ):
            sys.stdout.write("\n")
            sys.stdout.flush()
            sys.stdin.read()
    except InputError as error:
        known = error.renamed("--operator") if error.field == "--address" else error
        sys.stdout.write(f"{known}\n")


if __name__ == "__main__":
    main()
