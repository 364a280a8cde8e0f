"""SunSpec registers of a simulated inverter, and of the meter of a plant.

A unit is a list of models from address 40000 on. Measurements are worked out when they are read;
what is written to the points of a limit, or to `Conn`, is what the inverter is told.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterable, Mapping
from math import ceil, inf, log10, sqrt
from typing import Any, Final, TypeAlias

import msgspec
from pymodbus.constants import ExcCodes
from pymodbus.simulator import DataType, SimData, SimDevice
from sunspec2.device import Model

from sunspec.limited_inverter import LimitedInverter

Points: TypeAlias = Mapping[str, float | str]

FIRST_ADDRESS: Final = 40_000
_SUNS: Final = b"SunS"
_END: Final = b"\xff\xff\x00\x00"
_VOLTS: Final = 480.0
_UNSIGNED: Final = 65_535

_LIMIT_POINTS: Final = {
    123: {
        "Conn": "connected",
        "WMaxLim_Ena": "enabled",
        "WMaxLimPct": "percent",
        "WMaxLimPct_RvrtTms": "revert_s",
    },
    704: {
        "WMaxLimPctEna": "enabled",
        "WMaxLimPct": "percent",
        "WMaxLimPctRvrtTms": "revert_s",
        "WMaxLimPctEnaRvrt": "revert_enabled",
        "WMaxLimPctRvrt": "revert_percent",
        "WSetEna": "set_enabled",
        "WSetMod": "set_in_w",
        "WSet": "set_w",
    },
}
"""Points that may be written, and the fields of `LimitSettings` that they are."""

_RANGES: Final = {
    "percent": (0.0, 100.0),
    "revert_percent": (0.0, 100.0),
    "revert_s": (0.0, inf),
    "set_in_w": (1.0, 1.0),
    "set_w": (0.0, inf),
}
"""Of the values of fields; of all others from 0 to 1."""

_NO_REVERT: Final = {"revert_enabled": False, "revert_percent": 100.0}
"""What a limit by model 123, which has no such points, means for those of 704."""


class Registers:
    """The registers of one Modbus unit.

    models: Numbers of its models, the common model 1 first.
    points: Gives the points of a model at a time, scale factors first.
    """

    def __init__(
        self,
        unit: int,
        models: Iterable[int],
        now: Callable[[], float],
        points: Callable[[int, float], Points],
    ) -> None:
        self._now, self._points = now, points
        self._models: dict[int, tuple[int, Model]] = {}
        image, at = bytearray(_SUNS), now()
        for number in models:
            model = Model(number)
            self._models[number] = FIRST_ADDRESS + len(image) // 2, model
            self._work_out(number, model, at)
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
        """Bring the registers up to date that are read, or take those that are written."""
        at = self._now()
        for number, (begin, model) in self._models.items():
            if begin < address + count and address < begin + model.len:
                if values is not None:
                    first = address - begin
                    return self._write(number, model, first, [int(value) for value in values], at)
                self._work_out(number, model, at)
                image = struct.unpack(f">{model.len}H", model.get_mb())
                registers[begin - start : begin - start + model.len] = image
        return None if values is None else ExcCodes.ILLEGAL_ADDRESS

    def _work_out(self, number: int, model: Model, at: float) -> None:
        for name, value in self._points(number, at).items():
            model.points[name].cvalue = value

    def _write(
        self, number: int, model: Model, first: int, values: list[int], at: float
    ) -> ExcCodes | None:
        return ExcCodes.ILLEGAL_ADDRESS


class InverterRegisters(Registers):
    """The registers of a simulated inverter.

    inverter, name: The inverter, and its path in the control tree.
    on_limit: Called when it is told a limit.
    missing: Points that it has not.
    """

    def __init__(
        self,
        unit: int,
        models: Iterable[int],
        now: Callable[[], float],
        inverter: LimitedInverter,
        name: str,
        on_limit: Callable[[], None],
        missing: Collection[str] = (),
    ) -> None:
        self._inverter, self._name, self._unit, self._on_limit = inverter, name, unit, on_limit
        self._missing = missing
        super().__init__(unit, models, now, self._inverter_points)

    def _write(
        self, number: int, model: Model, first: int, values: list[int], at: float
    ) -> ExcCodes | None:
        """Take points of a limit, all of them or none."""
        known = _LIMIT_POINTS.get(number, {})
        data = struct.pack(f">{len(values)}H", *values)
        told: dict[str, Any] = {}
        for name, point in model.points.items():
            place = point.offset - first
            if place + point.len <= 0 or place >= len(values):
                continue
            if name not in known or place < 0 or place + point.len > len(values):
                return ExcCodes.ILLEGAL_ADDRESS
            point.set_mb(data[2 * place : 2 * (place + point.len)])
            told[known[name]] = point.cvalue
        for field, value in told.items():
            low, high = _RANGES.get(field, (0.0, 1.0))
            if value is None or not low <= value <= high:
                return ExcCodes.ILLEGAL_VALUE
        renews = not told.keys() <= {"connected", "set_enabled", "set_in_w", "set_w"}
        if renews and number == 123:
            told |= _NO_REVERT
        self._on_limit()
        self._inverter.advance(at)  # It may have reverted meanwhile.
        settings = msgspec.structs.replace(self._inverter.settings, **told)
        self._inverter.told(settings, at, renews=renews)
        return None

    def _inverter_points(self, number: int, at: float) -> Points:
        self._inverter.advance(at)
        if number == 1:
            return common("simulated inverter", self._name, self._unit)
        points = _POINTS[number](self._inverter, at)
        return {name: value for name, value in points.items() if name not in self._missing}


def no_unit() -> SimDevice:
    """Return what answers for units that do not exist."""

    async def refuse(*request: object) -> ExcCodes:
        return ExcCodes.GATEWAY_NO_RESPONSE

    nothing = SimData(FIRST_ADDRESS, count=4, values=0, datatype=DataType.REGISTERS)
    return SimDevice(0, nothing, action=refuse)


def meter_registers(
    unit: int, now: Callable[[], float], inverters: Iterable[LimitedInverter]
) -> Registers:
    """Return the registers of the meter where a plant is connected: power fed in is positive."""
    inverters = list(inverters)
    sf = scale(1e3 * sum(inverter.rating_kw for inverter in inverters))

    def points(number: int, at: float) -> Points:
        if number == 1:
            return common("meter at the point of interconnection", "meter", unit)
        for inverter in inverters:
            inverter.advance(at)
        watts = 1e3 * sum(inverter.power_kw(at) for inverter in inverters)
        energy = sum(inverter.energy_kwh for inverter in inverters)
        amperes = _amperes(watts)
        return {
            "A_SF": 1, "V_SF": 0, "Hz_SF": -2, "W_SF": sf, "TotWh_SF": 3, "A": amperes,
            "AphA": amperes, "AphB": amperes, "AphC": amperes, "PhV": _VOLTS / sqrt(3.0),
            "PPV": _VOLTS, "Hz": 60, "W": watts, "TotWhExp": 1e3 * energy, "TotWhImp": 0, "Evt": 0,
        }  # fmt: skip

    return Registers(unit, (1, 203), now, points)


def common(what: str, name: str, unit: int) -> Points:
    return {"Mn": "Heliarch", "Md": what[:32], "SN": name[-32:], "Vr": "1", "DA": unit}


def scale(watts: float, largest: int = 32_767) -> int:
    """Return the scale factor with which a register that goes so far holds a power."""
    return max(ceil(log10(max(watts, 1.0) / largest)), 0)


def _measurements(inverter: LimitedInverter, at: float) -> Points:
    watts, volts = 1e3 * inverter.power_kw(at), _VOLTS / sqrt(3.0)
    amperes = _amperes(watts)
    return {
        "A_SF": 0, "V_SF": 0, "W_SF": scale(1e3 * inverter.rating_kw), "Hz_SF": -2, "WH_SF": 0,
        "Tmp_SF": 0, "A": amperes, "AphA": amperes, "AphB": amperes, "AphC": amperes,
        "PhVphA": volts, "PhVphB": volts, "PhVphC": volts, "W": watts, "Hz": 60,
        "WH": 1e3 * inverter.energy_kwh, "TmpCab": 40, "Evt1": 0, "Evt2": 0,
        "St": _state(inverter, at, off=1, sleeping=2, running=4, throttled=5),
    }  # fmt: skip


def _der_measurements(inverter: LimitedInverter, at: float) -> Points:
    throttled, connected = _throttled(inverter, at), inverter.settings.connected
    return {
        "W_SF": scale(1e3 * inverter.rating_kw), "TotWh_SF": 0, "Hz_SF": -2, "V_SF": 0,
        "ACType": 2, "St": connected, "ConnSt": connected, "Alrm": 0,
        "W": 1e3 * inverter.power_kw(at),
        "InvSt": _state(inverter, at, off=0, sleeping=1, running=3, throttled=4),
        "Hz": 60, "LLV": _VOLTS, "TotWhInj": 1e3 * inverter.energy_kwh,
        "ThrotPct": ceil(throttled), "ThrotSrc": 1 if throttled else 0,
    }  # fmt: skip


def _nameplate(inverter: LimitedInverter, at: float) -> Points:
    watts = 1e3 * inverter.rating_kw
    sf = scale(watts, _UNSIGNED)
    return {
        "WRtg_SF": sf, "VARtg_SF": sf, "VArRtg_SF": 0, "ARtg_SF": 0, "PFRtg_SF": -2,
        "DERTyp": 4, "WRtg": watts, "VARtg": watts, "VArRtgQ1": 0, "VArRtgQ2": 0, "VArRtgQ3": 0,
        "VArRtgQ4": 0, "ARtg": _amperes(watts), "PFRtgQ1": 1, "PFRtgQ2": 1, "PFRtgQ3": 1,
        "PFRtgQ4": 1,
    }  # fmt: skip


def _settings(inverter: LimitedInverter, at: float) -> Points:
    watts = 1e3 * inverter.rating_kw
    ramp = {} if inverter.ramp_percent_per_s == inf else {"WGra": inverter.ramp_percent_per_s}
    return {
        "WMax_SF": scale(watts, _UNSIGNED), "VRef_SF": 0, "VRefOfs_SF": 0, "WGra_SF": -1,
        "WMax": watts, "VRef": _VOLTS, "VRefOfs": 0, **ramp,
    }  # fmt: skip


def _status(inverter: LimitedInverter, at: float) -> Points:
    return {
        "WAval_SF": scale(1e3 * inverter.rating_kw, _UNSIGNED), "PVConn": 7, "StorConn": 0,
        "ECPConn": 2 if inverter.settings.connected else 1,
        "ActWh": round(1e3 * inverter.energy_kwh),
        "WAval": 1e3 * inverter.possible_kw(at), "StActCtl": inverter.settings.enabled,
    }  # fmt: skip


def _controls(inverter: LimitedInverter, at: float) -> Points:
    return {
        "WMaxLimPct_SF": -2, "OutPFSet_SF": -2, "OutPFSet": 1, "OutPFSet_Ena": 0,
        "VArPct_Ena": 0, **_limit_points(123, inverter),
    }  # fmt: skip


def _capacity(inverter: LimitedInverter, at: float) -> Points:
    watts = 1e3 * inverter.rating_kw
    return {"W_SF": scale(watts, _UNSIGNED), "WMaxRtg": watts, "WMax": watts}


def _der_controls(inverter: LimitedInverter, at: float) -> Points:
    ramp = inverter.ramp_percent_per_s
    return {
        "WMaxLimPct_SF": -2, "WSet_SF": 0, **_limit_points(704, inverter),
        "WMaxLimPctRvrtRem": ceil(inverter.revert_in_s(at)),
        **({} if ramp == inf else {"WRmp": round(ramp), "WRmpRef": 1}),
    }  # fmt: skip


_POINTS: Final[dict[int, Callable[[LimitedInverter, float], Points]]] = {
    103: _measurements,
    120: _nameplate,
    121: _settings,
    122: _status,
    123: _controls,
    701: _der_measurements,
    702: _capacity,
    704: _der_controls,
}
INVERTER_MODELS: Final = (1, *_POINTS)


def _limit_points(number: int, inverter: LimitedInverter) -> Points:
    settings = inverter.settings
    return {name: getattr(settings, field) for name, field in _LIMIT_POINTS[number].items()}


def _state(
    inverter: LimitedInverter, at: float, *, off: int, sleeping: int, running: int, throttled: int
) -> int:
    if not inverter.settings.connected:
        return off
    if inverter.possible_kw(at) <= 0.0:
        return sleeping
    return throttled if _throttled(inverter, at) else running


def _throttled(inverter: LimitedInverter, at: float) -> float:
    """Return what a limit holds back, in per cent of the rating."""
    held_kw = inverter.possible_kw(at) - inverter.power_kw(at)
    return 100.0 * held_kw / inverter.rating_kw if held_kw > 1e-6 * inverter.rating_kw else 0.0


def _amperes(watts: float) -> float:
    return watts / (sqrt(3.0) * _VOLTS)
