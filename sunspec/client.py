"""An inverter or a meter over Modbus TCP, by the SunSpec models that it has.

pysunspec2 knows the models and speaks Modbus. Power comes from 701 or 103, the limit is set in 704
or 123, and 122 states the available power. A meter has 203, or another of its family.
https://github.com/sunspec/models
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite, isnan, nan
from typing import Final

from sunspec2.modbus.client import SunSpecModbusClientDeviceTCP
from sunspec2.modbus.client import SunSpecModbusClientModel as Model
from sunspec2.modbus.client import SunSpecModbusClientPoint as Point
from sunspec2.modbus.modbus import ModbusClientException

from sim_plant.real_inverters import Reading
from sunspec.addresses import parse_address
from sunspec.limited_inverter import LIMIT_POINTS, LONGEST_REVERT_S

_MEASUREMENTS: Final = (701, 103, 102, 101)
_METERS: Final = (203, 204, 202, 201)
_LIMITS: Final = (704, 123)
_RATINGS: Final = ((702, "WMax"), (702, "WMaxRtg"), (121, "WMax"), (120, "WRtg"))
"""What 100 % stands for, in the order of preference."""

_TIMEOUT_S: Final = 2.0


class DeviceError(Exception):
    """A device does not answer, or not as it must; the text is one line."""


class DeviceRefusedError(DeviceError):
    """A device answers that it does not do what is asked; the connection stays."""


class SunSpecDevice(ABC):
    """What inverters and meters have in common: a connection, and its errors in one line.

    address: `modbus://host:port/unit`.
    state: Its state by name: `MPPT`, `THROTTLED`, `FAULT`; empty if it states none.
    """

    def __init__(self, address: str) -> None:
        host, port, unit = parse_address(address, "device")
        self.address = address
        self.state = ""
        self._device = SunSpecModbusClientDeviceTCP(unit, host, port, timeout=_TIMEOUT_S)

    def connect(self) -> None:
        """Connect and find out which models the device has.

        Raises DeviceError: Nothing listens, there is no such unit, or it lacks a model or a point.
        """
        with self._errors():
            self._device.connect()
            self._device.scan(connect=False)
        self._find_models()

    def close(self) -> None:
        """Hang up; `connect` may be called again."""
        self._device.disconnect()

    @abstractmethod
    def read(self) -> Reading:
        """Read power, available power and limit. Raises DeviceError: It does not answer."""

    @abstractmethod
    def _find_models(self) -> None:
        """Find the models to read and write. Raises DeviceError: A model or a point is missing."""

    def _power_kw(self, model: Model) -> float:
        power_kw = self._kw(model, "W")
        if isnan(power_kw):
            raise DeviceRefusedError(f"{self.address}: it states no power W")
        return power_kw

    def _kw(self, model: Model, name: str) -> float:
        """Return a power that a model states; NaN if it states none."""
        watts = model.points[name].cvalue
        return watts / 1e3 if watts is not None and isfinite(watts) else nan

    def _model(self, *wanted: int) -> Model:
        for model in wanted:
            if model in self._device.models:
                return self._device.models[model][0]
        needed = " or ".join(map(str, wanted[:2]))
        raise DeviceError(f"{self.address}: expected SunSpec model {needed}, got none of them")

    def _need(self, model: Model, name: str) -> None:
        if model.points[name].value is None:
            raise DeviceError(
                f"{self.address}: expected the point {name} in SunSpec model {model.model_id}"
            )

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Turn what pysunspec2 raises into one line; hang up unless the device has answered."""
        try:
            yield
        except DeviceError:
            raise
        except ModbusClientException as error:
            raise DeviceRefusedError(f"{self.address}: {error}") from None
        except Exception as error:  # What is no SunSpec fails anywhere in pysunspec2.
            self.close()
            expected = "a device with SunSpec models at this address and unit"
            got = " ".join(str(error).split()) or type(error).__name__
            raise DeviceError(f"{self.address}: expected {expected}, got: {got}") from None


class SunSpecMeter(SunSpecDevice):
    """The meter where a plant is connected: power fed in is positive."""

    def _find_models(self) -> None:
        self._metered = self._model(*_METERS)
        self._need(self._metered, "W")

    def read(self) -> Reading:
        with self._errors():
            self._metered.read()
            return Reading(time.monotonic_ns(), self._power_kw(self._metered))


class SunSpecInverter(SunSpecDevice):
    """An inverter that is read and limited. Nothing is written to it before `limit` is called."""

    def __init__(self, address: str) -> None:
        super().__init__(address)
        self.rating_kw = 0.0

    def _find_models(self) -> None:
        models = self._device.models
        self._measured = self._model(*_MEASUREMENTS)
        self._limited = self._model(*_LIMITS)
        self._extended = models.get(122, (None,))[0]
        self._points: dict[str, Point] = {}
        self._need(self._measured, "W")
        for name, field in LIMIT_POINTS[self._limited.model_id].items():
            self._points[field] = self._limited.points[name]
            if field != "connected":
                self._need(self._limited, name)
        ratings_kw = [self._kw(models[at][0], name) for at, name in _RATINGS if at in models]
        self.rating_kw = next((kw for kw in ratings_kw if kw > 0.0), 0.0)
        if not self.rating_kw:
            raise DeviceError(f"{self.address}: expected a rating in model 702, 121 or 120")

    def read(self) -> Reading:
        with self._errors():
            self._measured.read()
            self._limited.read()
            if self._extended is not None:
                self._extended.read()
            power_kw = self._power_kw(self._measured)
            enabled, percent = (self._points[field].cvalue for field in ("enabled", "percent"))
            limit_kw = self.rating_kw
            if enabled == 1 and percent is not None:
                limit_kw *= min(max(percent, 0.0), 100.0) / 100.0
            point = self._measured.points["InvSt" if self._measured.model_id == 701 else "St"]
            names = {symbol["value"]: symbol["name"] for symbol in point.pdef.get("symbols", ())}
            self.state = str(names.get(point.value, ""))
            available_kw = self._available_kw(power_kw)
        return Reading(time.monotonic_ns(), power_kw, available_kw, limit_kw)

    def limit(self, kw: float, revert_s: float, revert_kw: float = nan) -> None:
        """Limit the power, for the revert time.

        revert_s: After this time without another limit the inverter goes to `revert_kw`.
        revert_kw: The limit from then on; NaN: it releases its power, as model 123 always does.
        """
        settings: dict[str, float] = {
            "enabled": 1,
            "percent": self._percent(kw),
            "revert_s": min(max(round(revert_s), 1), LONGEST_REVERT_S),
            "revert_enabled": not isnan(revert_kw),
            "revert_percent": 100.0 if isnan(revert_kw) else self._percent(revert_kw),
        }
        with self._errors():
            for field in settings.keys() & self._points.keys():
                self._points[field].cvalue = settings[field]
            self._limited.write()

    def _percent(self, kw: float) -> float:
        return min(max(100.0 * kw / self.rating_kw, 0.0), 100.0)

    def _available_kw(self, power_kw: float) -> float:
        """Return the power that there could be: what is not throttled gives all there is."""
        if self._extended is not None and not isnan(stated_kw := self._kw(self._extended, "WAval")):
            return stated_kw
        throttled = self._measured.points.get("ThrotPct")
        is_free = self.state == "MPPT" if throttled is None else throttled.value == 0
        return power_kw if is_free else nan
