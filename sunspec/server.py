"""The simulated inverters of a plant as SunSpec devices, and a meter where it is connected."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pymodbus.server import ModbusTcpServer

from bus_schemas.errors import InputError
from sunspec.limited_inverter import LimitedInverter
from sunspec.registers import (
    Points,
    Registers,
    inverter_points,
    inverter_registers,
    meter_registers,
    no_unit,
)

_MOST_UNITS = 247

logging.getLogger("pymodbus").setLevel(logging.ERROR)  # Its warnings are said in our words.


class Sky:
    """The true maxima of a plant's inverters as time passes, one row after another.

    mpp_kw: Maximum power of each inverter in each cycle, shape (cycles, n).
    began_at: When the first cycle begins [s]; None: the sky stands still until `begin`.
    """

    def __init__(self, mpp_kw: NDArray[np.float64], cycle_s: float, began_at: float | None) -> None:
        self._mpp_kw, self._cycle_s = mpp_kw, cycle_s
        self.began_at = began_at

    def begin(self, at: float) -> None:
        """Let the sky move on from now, unless it does already."""
        if self.began_at is None:
            self.began_at = at

    def is_over(self, at: float) -> bool:
        return self._cycle(at) >= len(self._mpp_kw)

    def possible_kw(self, place: int) -> Callable[[float], float]:
        return lambda at: float(self._mpp_kw[min(self._cycle(at), len(self._mpp_kw) - 1), place])

    def _cycle(self, at: float) -> int:
        return 0 if self.began_at is None else max(int((at - self.began_at) / self._cycle_s), 0)


@dataclass(frozen=True, kw_only=True)
class ServedPlant:
    """What is served, and where.

    sky: Begins with the first limit, unless it has begun already.
    host, port: Where to listen. Port 0: any that is free.
    a_port_each: Whether each inverter has its own port instead of its own unit.
    points: Returns the points of an inverter's models at a time.
    """

    inverters: Mapping[str, LimitedInverter]
    sky: Sky
    now: Callable[[], float]
    host: str = "127.0.0.1"
    port: int = 0
    a_port_each: bool = False
    points: Callable[[LimitedInverter, float], Points] = inverter_points

    def units(self) -> dict[str, Registers]:
        """Return the inverters by path, and the `meter`."""
        if not self.a_port_each and len(self.inverters) >= _MOST_UNITS:
            raise InputError(
                f"inverters: expected up to {_MOST_UNITS - 1} at one port, got "
                f"{len(self.inverters)}; --base-port gives each a port of its own"
            )

        def begin() -> None:
            self.sky.begin(self.now())

        found: dict[str, Registers] = {}
        for place, (name, inverter) in enumerate(self.inverters.items()):
            unit = 1 if self.a_port_each else place + 1
            found[name] = inverter_registers(unit, name, inverter, self.now, begin, self.points)
        unit = 1 if self.a_port_each else len(self.inverters) + 1
        return found | {"meter": meter_registers(unit, self.inverters.values(), self.now)}


@contextmanager
def served(plant: ServedPlant) -> Iterator[dict[str, str]]:
    """Serve a plant as long as the context lasts, in a thread; gives the addresses by name."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, name="Modbus", daemon=True)
    thread.start()
    servers: list[ModbusTcpServer] = []
    try:
        yield asyncio.run_coroutine_threadsafe(_serve(plant, servers), loop).result()
    finally:
        for server in servers:
            asyncio.run_coroutine_threadsafe(server.shutdown(), loop).result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


async def _serve(plant: ServedPlant, servers: list[ModbusTcpServer]) -> dict[str, str]:
    units = plant.units()
    shared = [[name] for name in units] if plant.a_port_each else [list(units)]
    addresses = {}
    for number, names in enumerate(shared):
        wanted = plant.port + number if plant.port else 0
        devices = [units[name].device for name in names]
        server = ModbusTcpServer([*devices, no_unit()], address=(plant.host, wanted))
        servers.append(server)
        try:
            await server.serve_forever(background=True)
        except RuntimeError:
            raise InputError(
                f"inverters: expected a free port of this machine, got {plant.host} port {wanted}"
            ) from None
        transport = server.transport
        assert isinstance(transport, asyncio.Server)
        port = transport.sockets[0].getsockname()[1]
        for name, device in zip(names, devices, strict=True):
            addresses[name] = f"modbus://{plant.host}:{port}/{device.id}"
    return addresses
