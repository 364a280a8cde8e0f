"""The direct controller of a storage, written from docs/wire.md like that of an inverter.

heliarch launch oahu-storage --external battery --pace 1 --out my-run
python examples/storage_controller.py --plan my-run/plan.json --node battery
"""

from __future__ import annotations

from typing import Any

from direct_controller import METER_TOLERANCE, ROUNDING, DirectController, main

NOTHING = (0.0, 0.0, 0.0)  # It can give and take nothing, and needs none to be at its target.


class StorageController(DirectController):
    """States what its storage can give and take; commands its setpoint, without one 0 kW."""

    def __init__(self, plan: dict[str, Any], node: str, endpoints: list[str]) -> None:
        super().__init__(plan, node, endpoints)
        name = node.rpartition("/")[2]
        (self.storage,) = (one for one in plan["storages"] if one["name"] == name)
        self.rating_kw = self.storage["rating_kw"]

    def forget(self) -> None:
        super().forget()
        self.able = NOTHING

    def is_usable(self, signal: str, message: dict[str, Any]) -> bool:
        if signal == "setpoint":
            return bool(abs(message["power_kw"]) <= self.rating_kw * (1.0 + ROUNDING))
        return super().is_usable(signal, message)

    def measure(self, telemetry: dict[str, Any] | None) -> None:
        """Work out what the storage can do; nothing if it does not say what is stored in it."""
        self.stale_cycles += 1
        if telemetry is None:
            return
        self.measured_cycle, self.stale_cycles = telemetry["cycle"], 0
        power_kw, energy_kwh = telemetry["power_kw"], telemetry.get("energy_kwh")
        is_sane = abs(power_kw) <= self.rating_kw * (1.0 + METER_TOLERANCE)  # Not so if it is NaN.
        self.able = (
            self.ability(energy_kwh, power_kw) if energy_kwh is not None and is_sane else NOTHING
        )

    def ability(self, energy_kwh: float, power_kw: float) -> tuple[float, float, float]:
        """Return what it can give and take through the cycle, and what of that charges it."""
        one, cycle_s = self.storage, self.plan["timing"]["cycle_ns"] / 1e9
        cycle_h = cycle_s / 3600.0
        lowest_kwh, highest_kwh, target_kwh = (
            one[name] * one["capacity_kwh"] for name in ("lowest_state", "highest_state", "target")
        )
        ramp = one["ramp_percent_per_s"]
        ramp_kw = float("inf") if ramp is None else ramp / 100.0 * self.rating_kw * cycle_s
        into_kw_per_kwh = 1.0 / (one["charge_efficiency"] * cycle_h)
        stored_kw = max(energy_kwh - lowest_kwh, 0.0) * one["discharge_efficiency"] / cycle_h
        room_kw = max(highest_kwh - energy_kwh, 0.0) * into_kw_per_kwh
        discharge_kw = max(min(self.rating_kw, stored_kw, power_kw + ramp_kw), 0.0)
        absorb_kw = max(min(self.rating_kw, room_kw, ramp_kw - power_kw), 0.0)
        charge_kw = min(absorb_kw, max(target_kwh - energy_kwh, 0.0) * into_kw_per_kwh)
        return discharge_kw, absorb_kw, charge_kw

    def report(self, dispatch: dict[str, Any] | None) -> None:
        """Say what it can do. Its share of the dispatch is 0."""
        is_old = self.stale_cycles > self.plan["control"]["hold_cycles"]
        names = ("discharge_kw", "absorb_kw", "charge_kw")
        able = dict(zip(names, NOTHING if is_old else self.able, strict=True))
        power_kw = able["discharge_kw"]
        self.publish("impp", power_kw=power_kw, stale_cycles=self.stale_cycles, **able)
        self.publish("residual", power_kw=power_kw)

    def actuate(self) -> None:
        """Command the setpoint; where the dispatch has expired too, let the storage revert."""
        if self.measured_cycle is None:
            return
        setpoint, dispatch = self.inputs("setpoint", "dispatch")
        if setpoint is not None or dispatch is not None:
            power_kw = 0.0 if setpoint is None else setpoint["power_kw"]
            self.publish("command", alpha=1.0, power_kw=power_kw, revert_kw=0.0)


if __name__ == "__main__":
    main(StorageController)
