"""SunSpec registers of a simulated inverter or storage, and of the meter of a plant.

A unit is a list of models from address 40000 on. Measurements are worked out when they are read;
what is written to the points of a limit, of a set power, or to `Conn`, is applied to the device.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping
from math import ceil, inf, log10, sqrt
from typing import Any, Final, TypeAlias

import msgspec
from pymodbus.constants import ExcCodes
from pymodbus.simulator import DataType, SimData, SimDevice
from sunspec2.device import Model

from bus_schemas.errors import FailureError
from sunspec.simulated import LIMIT_POINTS, SET_POINTS, Commanded, LimitedInverter, SetStorage

Points: TypeAlias = dict[int, dict[str, float | str]]
"""Points of each model of a unit, by the model's number; scale factors first."""

COUNTS: Final = ("NPrt", "NCrv", "NCrvSet", "NCtl", "NStr", "NMod", "NProf", "IVLen")
NO_MEMBERS: Final = dict.fromkeys(COUNTS, 0)
"""The points that count members of groups: without one pysunspec2 makes no model with groups."""

FIRST_ADDRESS: Final = 40_000
_SUNS: Final = b"SunS"
_END: Final = b"\xff\xff\x00\x00"
_VOLTS: Final = 480.0
_UNSIGNED: Final = 65_535

_OFF, _SLEEPING, _RUNNING, _THROTTLED = 1, 2, 4, 5
"""States of model 103; those of 701 are one less."""

_NO_REVERT: Final = {"revert_enabled": False, "revert_percent": 100.0}
"""Points of model 704 that 123 lacks, as a limit by model 123 sets them."""


class Registers:
    """The registers of one Modbus unit.

    points: Returns its present points; the first model is the common one, 1.
    write_limit: Called with a model's number and the fields of `LimitSettings` that were written
        to it. Raises ValidationError: A value is out of range. Raises FailureError: Not now. Not
        used for units without a model of `writable`.
    writable: By model, the points that may be written, and the fields that they set.
    """

    def __init__(
        self,
        unit: int,
        points: Callable[[], Points],
        write_limit: Callable[[int, dict[str, Any]], None] | None = None,
        writable: Mapping[int, Mapping[str, str]] = LIMIT_POINTS,
    ) -> None:
        self._points, self._write_limit, self._writable = points, write_limit, writable
        self._models: dict[int, Model] = {}
        image = bytearray(_SUNS)
        for number, values in points().items():
            model = Model(number, data=NO_MEMBERS)
            self._models[FIRST_ADDRESS + len(image) // 2] = model
            model.set_dict(values, computed=True)
            image += model.get_mb()
        registers = list(struct.unpack(f">{(len(image) + 4) // 2}H", image + _END))
        self.device = SimDevice(
            unit,
            SimData(FIRST_ADDRESS, values=registers, datatype=DataType.REGISTERS),
            action=self._access,
        )

    async def _access(
        self,
        function: int,
        start: int,
        address: int,
        count: int,
        registers: list[int],
        values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """Update the registers that are read, or apply those that are written."""
        points = self._points()
        for begin, model in self._models.items():
            if begin < address + count and address < begin + model.len:
                model.set_dict(points[model.model_id], computed=True)
                if values is not None:
                    return self._write(model, address - begin, [int(value) for value in values])
                image = struct.unpack(f">{model.len}H", model.get_mb())
                registers[begin - start : begin - start + model.len] = image
        return None if values is None else ExcCodes.ILLEGAL_ADDRESS

    def _write(self, model: Model, first: int, values: list[int]) -> ExcCodes | None:
        """Take points of a limit, all of them or none.

        Registers in between may be written with what they hold.
        """
        known = self._writable.get(model.model_id, {})
        data = struct.pack(f">{len(values)}H", *values)
        written: dict[str, Any] = {}
        for name, point in model.points.items():
            register = point.offset - first
            if register + point.len <= 0 or register >= len(values):
                continue
            words = data[2 * max(register, 0) : 2 * (register + point.len)]
            if name not in known and words == point.get_mb():
                continue
            if name not in known or len(words) != 2 * point.len:
                return ExcCodes.ILLEGAL_ADDRESS
            point.set_mb(words)
            written[known[name]] = point.cvalue
        assert self._write_limit is not None
        try:
            self._write_limit(model.model_id, written)
        except msgspec.ValidationError:
            return ExcCodes.ILLEGAL_VALUE
        except FailureError:
            return ExcCodes.DEVICE_BUSY
        return None


def no_unit() -> SimDevice:
    """Return what answers for units that do not exist."""

    async def refuse(*request: object) -> ExcCodes:
        return ExcCodes.GATEWAY_NO_RESPONSE

    nothing = SimData(FIRST_ADDRESS, count=4, values=0, datatype=DataType.REGISTERS)
    return SimDevice(0, nothing, action=refuse)


def commanded_device(
    unit: int,
    name: str,
    device: Commanded,
    now: Callable[[], float],
    on_write: Callable[[], None],
    points: Callable[[Any, float], Points],
) -> SimDevice:
    """Return a simulated inverter or storage with a path in the control tree as a Modbus unit.

    on_write: Called when a limit or a power is written.
    points: Returns its points at a time, such as `inverter_points`.
    """
    is_storage = isinstance(device, SetStorage)

    def current() -> Points:
        at = now()
        device.advance(at)
        what = "simulated storage" if is_storage else "simulated inverter"
        return common_points(what, name, unit) | points(device, at)

    def write(model: int, written: dict[str, Any]) -> None:
        renews = written.keys() != {"connected"}
        if renews and model == 123:
            written |= _NO_REVERT
        at = now()
        device.advance(at)  # It may have reverted meanwhile.
        settings = device.with_written(written)
        on_write()
        device.apply(settings, at, renews=renews)

    return Registers(unit, current, write, SET_POINTS if is_storage else LIMIT_POINTS).device


def meter_device(unit: int, devices: Iterable[Commanded], now: Callable[[], float]) -> SimDevice:
    """Return the meter where a plant is connected: power fed in is positive."""
    devices = list(devices)
    rating_kw = sum(device.rating_kw for device in devices)
    exported_kwh = imported_kwh = 0.0

    def current() -> Points:
        nonlocal exported_kwh, imported_kwh
        at = now()
        for device in devices:
            device.advance(at)
        watts = 1e3 * sum(device.power_kw(at) for device in devices)
        # A storage that charges takes back what was given: neither counter may run backwards.
        more_kwh = sum(device.energy_kwh for device in devices) - (exported_kwh - imported_kwh)
        exported_kwh += max(more_kwh, 0.0)
        imported_kwh += max(-more_kwh, 0.0)
        what = common_points("plant meter", "meter", unit)
        return what | {203: meter_points(watts, exported_kwh, rating_kw, imported_kwh)}

    return Registers(unit, current).device


def meter_points(
    watts: float, exported_kwh: float, rating_kw: float, imported_kwh: float = 0.0
) -> dict[str, float | str]:
    """Return the points of model 203, where a plant of a rating is connected."""
    amperes = _amperes(watts)
    return {
        "A_SF": 1, "V_SF": 0, "Hz_SF": -2, "W_SF": _scale(1e3 * rating_kw), "TotWh_SF": 3,
        "A": amperes, "AphA": amperes, "AphB": amperes, "AphC": amperes,
        "PhV": _VOLTS / sqrt(3.0), "PPV": _VOLTS, "Hz": 60, "W": watts,
        "TotWhExp": 1e3 * exported_kwh, "TotWhImp": 1e3 * imported_kwh, "Evt": 0,
    }  # fmt: skip


def inverter_points(inverter: LimitedInverter, at: float) -> Points:
    """Return the points of all models of an inverter, except the common one."""
    rating_kw, ramp = inverter.rating_kw, inverter.ramp_percent_per_s
    power_kw, available_kw = inverter.power_kw(at), inverter.available_kw(at)
    connected = inverter.settings.connected
    rating, watts, energy = 1e3 * rating_kw, 1e3 * power_kw, 1e3 * inverter.energy_kwh
    signed, unsigned = _scale(rating), _scale(rating, _UNSIGNED)
    amperes, phase_volts = _amperes(watts), _VOLTS / sqrt(3.0)
    state, _ = _state(rating_kw, power_kw, available_kw, connected=connected)
    limits = {
        number: {name: getattr(inverter.settings, field) for name, field in fields.items()}
        for number, fields in LIMIT_POINTS.items()
    }
    return {
        103: {
            "A_SF": 0, "V_SF": 0, "W_SF": signed, "Hz_SF": -2, "WH_SF": 0, "Tmp_SF": 0,
            "A": amperes, "AphA": amperes, "AphB": amperes, "AphC": amperes,
            "PhVphA": phase_volts, "PhVphB": phase_volts, "PhVphC": phase_volts, "W": watts,
            "Hz": 60, "WH": energy, "TmpCab": 40, "Evt1": 0, "Evt2": 0, "St": state,
        },
        120: {
            "WRtg_SF": unsigned, "VARtg_SF": unsigned, "VArRtg_SF": 0, "ARtg_SF": 0,
            "PFRtg_SF": -2, "DERTyp": 4, "WRtg": rating, "VARtg": rating, "VArRtgQ1": 0,
            "VArRtgQ2": 0, "VArRtgQ3": 0, "VArRtgQ4": 0, "ARtg": _amperes(rating), "PFRtgQ1": 1,
            "PFRtgQ2": 1, "PFRtgQ3": 1, "PFRtgQ4": 1,
        },
        121: {
            "WMax_SF": unsigned, "VRef_SF": 0, "VRefOfs_SF": 0, "WGra_SF": -1, "WMax": rating,
            "VRef": _VOLTS, "VRefOfs": 0, **({} if ramp == inf else {"WGra": ramp}),
        },
        122: {
            "WAval_SF": unsigned, "PVConn": 7, "StorConn": 0, "ECPConn": 2 if connected else 1,
            "ActWh": round(energy), "WAval": 1e3 * available_kw,
            "StActCtl": inverter.settings.enabled,
        },
        123: {
            "WMaxLimPct_SF": -2, "OutPFSet_SF": -2, "OutPFSet": 1, "OutPFSet_Ena": 0,
            "VArPct_Ena": 0, **limits[123],
        },
        701: operating_points(
            rating_kw, power_kw, available_kw, inverter.energy_kwh, connected=connected
        ),
        702: rating_points(rating_kw),
        704: {
            "WMaxLimPct_SF": -2, **limits[704],
            "WMaxLimPctRvrtRem": ceil(inverter.revert_in_s(at)),
            # A whole number of percent, and 0 is no ramp: a slower one than 1 %/s is 1 %/s.
            **({} if ramp == inf else {"WRmp": max(round(ramp), 1), "WRmpRef": 1}),
        },
    }  # fmt: skip


def storage_points(storage: SetStorage, at: float) -> Points:
    """Return the points of all models of a storage, except the common one."""
    one, rating, stored_kwh = storage.storage, 1e3 * storage.rating_kw, storage.stored_kwh
    power_kw, capacity = storage.power_kw(at), 1e3 * one.capacity_kwh
    operating = operating_points(storage.rating_kw, power_kw, power_kw, 0.0)
    del operating["TotWhInj"]  # It would count what is given alone.
    loss = one.charge_efficiency if power_kw < 0.0 else 1.0 / one.discharge_efficiency
    return {
        701: {**operating, "InvSt": _RUNNING - 1},
        702: {
            **rating_points(storage.rating_kw), "WChaRteMaxRtg": rating, "WChaRteMax": rating,
            "WDisChaRteMaxRtg": rating, "WDisChaRteMax": rating,
        },
        704: {
            "WSet_SF": _scale(rating, 2**31 - 1),
            **{name: getattr(storage.settings, field) for name, field in SET_POINTS[704].items()},
            "WSetRvrtRem": ceil(storage.revert_in_s(at)),
        },
        713: {
            "WH_SF": _scale(capacity, _UNSIGNED), "Pct_SF": -2, "WHRtg": capacity,
            "WHAvail": 1e3 * stored_kwh, "SoC": 1e5 * stored_kwh / capacity, "SoH": 100, "Sta": 0,
        },
        714: {"DCW_SF": _scale(rating / one.discharge_efficiency), "DCW": 1e3 * power_kw * loss},
    }  # fmt: skip


def operating_points(
    rating_kw: float,
    power_kw: float,
    available_kw: float,
    energy_kwh: float,
    *,
    connected: bool = True,
) -> dict[str, float | str]:
    """Return the points of model 701: power, energy, and how much a limit holds back."""
    state, throttled = _state(rating_kw, power_kw, available_kw, connected=connected)
    return {
        "W_SF": _scale(1e3 * rating_kw), "TotWh_SF": 0, "Hz_SF": -2, "V_SF": 0, "ACType": 2,
        "St": connected, "ConnSt": connected, "Alrm": 0, "W": 1e3 * power_kw, "InvSt": state - 1,
        "Hz": 60, "LLV": _VOLTS, "TotWhInj": 1e3 * energy_kwh, "ThrotPct": ceil(throttled),
        "ThrotSrc": 1 if throttled else 0,
    }  # fmt: skip


def rating_points(rating_kw: float) -> dict[str, float | str]:
    """Return the points of model 702."""
    rating = 1e3 * rating_kw
    return {"W_SF": _scale(rating, _UNSIGNED), "WMaxRtg": rating, "WMax": rating}


def _state(
    rating_kw: float, power_kw: float, available_kw: float, *, connected: bool
) -> tuple[int, float]:
    """Return the state of model 103, and how much of the rating a limit holds back [%]."""
    held_kw = available_kw - power_kw
    throttled = 100.0 * held_kw / rating_kw if held_kw > 1e-6 * rating_kw else 0.0
    if not connected:
        return _OFF, throttled
    if available_kw <= 0.0:
        return _SLEEPING, throttled
    return (_THROTTLED if throttled else _RUNNING), throttled


def common_points(what: str, name: str, unit: int) -> Points:
    return {1: {"Mn": "Heliarch", "Md": what, "SN": name[-32:], "Vr": "1", "DA": unit}}


def _scale(watts: float, largest: int = 32_767) -> int:
    """Return the scale factor with which a power fits into a register of values up to `largest`."""
    return max(ceil(log10(max(watts, 1.0) / largest)), 0)


def _amperes(watts: float) -> float:
    return watts / (sqrt(3.0) * _VOLTS)
