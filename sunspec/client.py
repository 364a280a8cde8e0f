"""An inverter, a storage or a meter over Modbus TCP, by the SunSpec models that it has.

pysunspec2 knows the models. Power comes from 701, 103 or 113, the limit is set in 704 or 123, and
122 states the available power. A storage states its energy in 713 or 802, its power may also come
from 714, and is set in 704. A meter has 203, 213, or another of their families.
https://github.com/sunspec/models
"""

from __future__ import annotations

import struct
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from math import isfinite, isnan, nan
from typing import Final, NamedTuple

from sunspec2.device import Model, Point

from agents.device_profile import PLAIN, DeviceProfile
from bus_schemas.errors import listed
from sim_plant.real_inverters import Reading
from sunspec.addresses import parse_address
from sunspec.modbus_tcp import (
    WRITE_SEVERAL,
    DeviceError,
    DeviceRefusedError,
    ModbusLink,
    NoAnswerError,
)
from sunspec.registers import NO_MEMBERS
from sunspec.simulated import LIMIT_POINTS, LONGEST_REVERT_S, SET_POINTS

_MEASUREMENTS: Final = (701, 103, 102, 101, 113, 112, 111)
_METERS: Final = (203, 204, 202, 201, 213, 214, 212, 211)
_RATINGS: Final = ((702, "WMax"), (702, "WMaxRtg"), (121, "WMax"), (120, "WRtg"))
"""What 100 % stands for, in the order of preference."""

_DISCHARGE: Final = ((702, "WDisChaRteMax"), (702, "WDisChaRteMaxRtg"), *_RATINGS)
_CHARGE: Final = ((702, "WChaRteMax"), (702, "WChaRteMaxRtg"), *_RATINGS)

_BASES: Final = (40_000, 0, 50_000)
_RESTING: Final = frozenset({"OFF", "SLEEPING", "STANDBY"})
"""States without power: what a device states of it, if anything, is what it draws itself."""

_REVERTS: Final = frozenset({"revert_s", "revert_enabled", "revert_percent", "revert_watts"})
_BEAT_S: Final = 1.0


class _Style(NamedTuple):
    """How registers are written: by which function, and with those in between in one request."""

    function: int
    block: bool


class DeviceModel:
    """A model of a device: where its registers are, and what they held when they were last read."""

    def __init__(self, link: ModbusLink, number: int, first: int, length: int, order: str) -> None:
        self.number = number
        self._link, self._first, self._length = link, first, length
        self._head = struct.pack(">HH", number, length)
        self._swaps = order == "low"
        self._model = Model(number, data=NO_MEMBERS)
        self._data = b""

    def is_there(self) -> bool:
        """Whether the device still has it there."""
        return self._link.read(self._first, 2) == self._head

    def read(self) -> None:
        """Read all registers. Raises DeviceError: They are of another model."""
        data = self._link.read(self._first, self._length + 2)
        if data[:4] != self._head:
            self._link.close()
            raise DeviceError(f"expected SunSpec model {self.number} at register {self._first}")
        self._data = data
        for name in self._model.points:
            point = self._model.points[name]
            words = data[2 * point.offset : 2 * (point.offset + point.len)]
            point.set_mb(self._ordered(words), dirty=False)

    def point(self, name: str) -> Point | None:
        """Return a point that is implemented."""
        point = self._model.points.get(name)
        return point if point is not None and point.value is not None else None

    def value(self, name: str) -> float:
        """Return a number with its scale factor; NaN if the device states none."""
        point = self.point(name)
        if point is None or self.lacks_scale(name):
            return nan
        value = point.cvalue
        return float(value) if isfinite(value) else nan

    def lacks_scale(self, name: str) -> str:
        """Return the scale factor that a point needs and that the device does not state."""
        scale = self._model.points[name].pdef.get("sf")
        return scale if isinstance(scale, str) and self.point(scale) is None else ""

    def symbol(self, name: str) -> str:
        """Return the name of the value of a point, such as `THROTTLED`; empty if there is none."""
        if (point := self.point(name)) is None:
            return ""
        names = {symbol["value"]: symbol["name"] for symbol in point.pdef.get("symbols", ())}
        return str(names.get(point.value, ""))

    def raw(self, name: str, value: float) -> int:
        """Return what a point's register holds for a number."""
        scale = self._model.points[name].pdef.get("sf")
        exponent = self._model.points[scale].value if isinstance(scale, str) else 0
        return round(value / 10.0**exponent)

    def write(self, raw: dict[str, int], style: _Style, last: str = "") -> None:
        """Write the registers of points. `last`: Point that is written last."""
        points = {name: self._model.points[name] for name in raw}
        data = {
            name: self._ordered(point.info.to_data(raw[name], 2 * point.len))
            for name, point in points.items()
        }
        if style.block:
            first = min(point.offset for point in points.values())
            image = bytearray(self._data)
            for name, point in points.items():
                image[2 * point.offset : 2 * (point.offset + point.len)] = data[name]
            end = max(point.offset + point.len for point in points.values())
            words = bytes(image[2 * first : 2 * end])
            self._link.write(self._first + first, words, style.function)
            return
        for name in sorted(points, key=lambda name: (name == last, points[name].offset)):
            self._link.write(self._first + points[name].offset, data[name], style.function)

    def _ordered(self, words: bytes) -> bytes:
        """Return a number of two registers with its high one first, as SunSpec has it."""
        return words[2:] + words[:2] if self._swaps and len(words) == 4 else words


class SunSpecDevice(ABC):
    """What inverters and meters have in common: a connection, and the models that were found.

    address: `modbus://host:port/unit`.
    state: Its state by name: `MPPT`, `THROTTLED`, `FAULT`; empty if it states none.
    """

    def __init__(self, address: str, profile: DeviceProfile = PLAIN) -> None:
        host, port, unit = parse_address(address, "device")
        self.address, self.profile = address, profile
        self.state = ""
        self._link = ModbusLink(address, host, port, unit, profile.timeout_s)
        self._models: dict[int, DeviceModel] = {}

    @property
    def drops(self) -> int:
        """How often the device has closed the connection."""
        return self._link.drops

    def connect(self) -> None:
        """Connect and find out, once, which models the device has.

        Raises DeviceError: Nothing listens, there is no such unit, or it lacks a model or a point.
        """
        self._link.open()
        if not (self._models and [*self._models.values()][-1].is_there()):
            self._models = {}
            try:
                self._scan()
                self._find_models()
            except DeviceError:
                self._models = {}
                raise

    def close(self) -> None:
        """Hang up; `connect` may be called again."""
        self._link.close()

    @abstractmethod
    def read(self) -> Reading:
        """Read power, available power and limit. Raises DeviceError: It does not answer."""

    @abstractmethod
    def _find_models(self) -> None:
        """Find the models to read and write. Raises DeviceError: A model or a point is missing."""

    def _scan(self) -> None:
        """Find where models begin. What was found until the device refuses to go on is kept."""
        at = self._base() + 2
        while at < 65_535:
            try:
                number, length = struct.unpack(">HH", self._link.read(at, 2))
            except (DeviceRefusedError, NoAnswerError) as error:
                if isinstance(error, DeviceRefusedError) and error.is_passing:
                    raise
                return
            if number in {0, 0xFFFF}:
                return
            model = DeviceModel(self._link, number, at, length, self.profile.word_order)
            self._models.setdefault(number, model)
            at += 2 + length

    def _base(self) -> int:
        stated = self.profile.base_address
        bases = _BASES if stated is None else (stated,)
        found: list[str] = []
        for base in bases:
            try:
                if self._link.read(base, 2) == b"SunS":
                    return base
                found.append("other registers")
            except (DeviceRefusedError, NoAnswerError) as error:
                if isinstance(error, DeviceRefusedError) and error.is_passing:
                    raise
                found.append(str(error).removeprefix(f"{self.address}: "))
        places = " or ".join(map(str, bases))
        hint = "" if stated is not None else "; profile = { base_address = ... } says where"
        raise self._error(
            f"expected SunSpec registers in this unit at {places}, got {found[0]}{hint}"
        )

    def _model(self, *wanted: int) -> DeviceModel:
        for number in wanted:
            if number in self._models:
                self._models[number].read()
                return self._models[number]
        needed = " or ".join(map(str, wanted[:2]))
        found = listed([*map(str, sorted(self._models))]) or "none"
        raise self._error(f"expected SunSpec model {needed}, got {found}")

    def _need(self, model: DeviceModel, name: str, hint: str = "") -> None:
        if model.point(name) is None:
            raise self._error(
                f"expected the point {name} in SunSpec model {model.number}, got none{hint}"
            )
        if scale := model.lacks_scale(name):
            raise self._error(
                f"expected the scale factor {scale} in SunSpec model {model.number}, got none"
            )

    def _power_kw(self, model: DeviceModel, point: str = "W") -> float:
        power_kw = model.value(point) / 1e3
        if isnan(power_kw) and self.state in _RESTING:
            return 0.0
        if isnan(power_kw):
            scale = model.lacks_scale(point)
            state = f" in state {self.state}" if self.state else ""
            what = f"no scale factor {scale}" if scale else f"no power {point}{state}"
            raise DeviceRefusedError(f"{self.address}: it states {what}")
        return power_kw

    def _stated_kw(self, points: Iterable[tuple[int, str]]) -> float:
        """Return the first power above 0 that a point states. Raises DeviceError: There is none."""
        for number, name in points:
            if number in self._models and (kw := self._model(number).value(name) / 1e3) > 0.0:
                return kw
        raise self._error("expected a rating in model 702, 121 or 120, got none")

    def _error(self, text: str) -> DeviceError:
        return DeviceError(f"{self.address}: {text}")


class SunSpecMeter(SunSpecDevice):
    """The meter where a plant is connected: power fed in is positive."""

    def _find_models(self) -> None:
        self._metered = self._model(*_METERS)
        self._need(self._metered, "W")

    def read(self) -> Reading:
        self._metered.read()
        return Reading(time.monotonic_ns(), self._power_kw(self._metered))


class SunSpecInverter(SunSpecDevice):
    """An inverter that is read and limited. Nothing is written to it before `set_power`."""

    def __init__(self, address: str, profile: DeviceProfile = PLAIN) -> None:
        super().__init__(address, profile)
        self.rating_kw = 0.0
        functions = [profile.write_function] if profile.write_function else [16, 6]
        self._styles = [
            *([_Style(WRITE_SEVERAL, block=True)] * (16 in functions and profile.block_write)),
            *(_Style(function, block=False) for function in functions),
        ]
        self._knows_style = False
        self._beats, self._beat_at = 0, 0.0

    def _find_models(self) -> None:
        self._measured = self._model(*_MEASUREMENTS)
        self._extended = self._model(122) if 122 in self._models else None
        self._find_control(LIMIT_POINTS)
        self.rating_kw = self._stated_kw(_RATINGS)

    def _find_control(self, points: Mapping[int, Mapping[str, str]]) -> None:
        """Find the model to write. Raises DeviceError: It, or one of its points, is missing."""
        self._control = self._model(*sorted(points, reverse=True))
        self._heart = self._model(715) if self.profile.heartbeat else None
        self._names = {field: name for name, field in points[self._control.number].items()}
        for field, name in self._names.items():
            if field in _REVERTS and self.profile.revert:
                hint = ": it would hold its last power for ever; profile = { revert = false } if so"
                self._need(self._control, name, hint)
            elif field not in _REVERTS and field != "connected":
                self._need(self._control, name)

    @property
    def requests(self) -> tuple[int, int]:
        """How many requests a reading takes, and a limit."""
        reads = [self._measured, self._control, self._extended]
        writes = 1 if self._styles[0].block else len(self._names) - 1
        return sum(one is not None for one in reads), writes

    def _read_all(self) -> None:
        self._beat()
        self._measured.read()
        self._control.read()
        if self._extended is not None:
            self._extended.read()

    def read(self) -> Reading:
        self._read_all()
        self.state = self._measured.symbol("InvSt" if self._measured.number == 701 else "St")
        power_kw = self._power_kw(self._measured)
        limit_kw, percent = self.rating_kw, self._control.value(self._names["percent"])
        if self._control.value(self._names["enabled"]) == 1 and not isnan(percent):
            limit_kw *= min(max(percent, 0.0), 100.0) / 100.0
        return Reading(time.monotonic_ns(), power_kw, self._available_kw(power_kw), limit_kw)

    def register(self, kw: float) -> int:
        """Return what the register of the limit, or the power, would hold for it."""
        percent = min(max(100.0 * kw / self.rating_kw, 0.0), 100.0)
        if step := self.profile.limit_step_percent:
            percent = min(round(percent / step) * step, 100.0)
        return self._control.raw(self._names["percent"], percent)

    def set_power(self, kw: float, revert_s: float, revert_kw: float = nan) -> None:
        """Limit the power, for the revert time.

        revert_s: After this time without another limit the inverter goes to `revert_kw`.
        revert_kw: The limit from then on; NaN: it releases its power, as model 123 always does.
        """
        reverts_to_kw = self.rating_kw if isnan(revert_kw) else revert_kw
        raw = {
            "percent": self.register(kw),
            "revert_enabled": int(not isnan(revert_kw)),
            "revert_percent": self.register(reverts_to_kw),
        }
        self._set(raw, revert_s)

    def _set(self, raw: dict[str, int], revert_s: float) -> None:
        """Write the registers of fields, and the revert time."""
        raw |= {"enabled": 1, "revert_s": round(min(max(revert_s, 1.0), LONGEST_REVERT_S))}
        skipped = frozenset() if self.profile.revert else _REVERTS
        if not self.profile.revert and self._control.value(self._names["enabled"]) == 1:
            skipped |= {"enabled"}  # It stays so, and some refuse to be written it.
        fields = raw.keys() & self._names.keys() - skipped
        self._write({self._names[field]: raw[field] for field in fields})

    def _write(self, raw: dict[str, int]) -> None:
        """Write in the first style that the device takes; the first success decides on it."""
        refusal = ""
        for _ in range(len(self._styles)):
            style = self._styles[0]
            try:
                self._control.write(raw, style, last=self._names["enabled"])
            except (DeviceRefusedError, NoAnswerError) as error:
                refusal = f"{error}: nothing was written"
                is_silent = isinstance(error, NoAnswerError)
                is_unknown = is_silent or getattr(error, "is_of_kind", False)
                if is_unknown and not self._knows_style:
                    self._styles.append(self._styles.pop(0))
                    # Silence is of the function, not of the registers.
                    self._styles.sort(key=lambda one: is_silent and one.function == style.function)
                if is_silent or not is_unknown or self._knows_style:
                    raise type(error)(refusal) from None
            else:
                self._knows_style = True
                return
        raise DeviceRefusedError(refusal)

    def _beat(self) -> None:
        if self._heart is not None and time.monotonic() >= self._beat_at + _BEAT_S:
            self._beat_at, self._beats = time.monotonic(), self._beats + 1
            function = self.profile.write_function or WRITE_SEVERAL
            self._heart.write({"ControllerHb": self._beats}, _Style(function, block=False))

    def _available_kw(self, power_kw: float) -> float:
        """Return the power that there could be: what is not throttled gives all there is."""
        if self.state in _RESTING:
            return 0.0
        stated_kw = nan if self._extended is None else self._extended.value("WAval") / 1e3
        if not isnan(stated_kw):
            return stated_kw
        throttled = self._measured.value("ThrotPct") if self._measured.number == 701 else nan
        is_free = self.state == "MPPT" if isnan(throttled) else throttled == 0
        return power_kw if is_free else nan


class SunSpecStorage(SunSpecInverter):
    """The inverter of a storage, which is given a power, negative to charge.

    capacity_kwh: As it states it; NaN: it does not.
    """

    def _find_models(self) -> None:
        self._measured = self._model(*_MEASUREMENTS, 714)
        self._find_control(SET_POINTS)
        self._extended = self._store = self._model(713, 802)
        for name in ("SoC", "WHRtg") if self._store.point("WHAvail") is None else ("WHAvail",):
            self._need(self._store, name)
        self.capacity_kwh = self._store.value("WHRtg") / 1e3
        self.rating_kw = self._stated_kw(_DISCHARGE)
        self._charge_kw = self._stated_kw(_CHARGE)

    def read(self) -> Reading:
        self._read_all()
        self.state = self._store.symbol("Sta" if self._store.number == 713 else "State")
        if self.state in {"ERROR", "FAULT"}:
            raise DeviceRefusedError(f"{self.address}: it states {self.state}")
        power_kw = self._power_kw(self._measured, "DCW" if self._measured.number == 714 else "W")
        energy_kwh = self._store.value("WHAvail") / 1e3
        if isnan(energy_kwh):
            energy_kwh = self._store.value("SoC") / 100.0 * self._store.value("WHRtg") / 1e3
        if isnan(energy_kwh):
            raise DeviceRefusedError(f"{self.address}: it states no energy WHAvail or SoC")
        return Reading(time.monotonic_ns(), power_kw, energy_kwh=energy_kwh)

    def register(self, kw: float) -> int:
        watts = 1e3 * min(max(kw, -self._charge_kw), self.rating_kw)
        return self._control.raw(self._names["watts"], watts)

    def set_power(self, kw: float, revert_s: float, revert_kw: float = 0.0) -> None:
        raw = {"in_watts": 1, "watts": self.register(kw)}
        raw |= {"revert_enabled": 1, "revert_watts": self.register(revert_kw)}
        self._set(raw, revert_s)
