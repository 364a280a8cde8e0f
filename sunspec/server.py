"""The simulated inverters and storages of a plant as SunSpec devices, and its meter."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager, contextmanager
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import SimDevice

from bus_schemas.errors import InputError
from sunspec.registers import (
    Points,
    commanded_device,
    inverter_points,
    meter_device,
    no_unit,
    storage_points,
)
from sunspec.simulated import LimitedInverter, SetStorage

_MOST_UNITS = 247

T = TypeVar("T")

logging.getLogger("pymodbus").setLevel(logging.ERROR)  # Its warnings are said in our words.


@dataclass
class Sky:
    """The true maxima of a plant's inverters as time passes, one row after another.

    mpp_kw: Maximum power of each inverter in each cycle, shape (cycles, n).
    began_at: When the first cycle begins [s]; None: the sky stands still until a limit is written.
    """

    mpp_kw: NDArray[np.float64]
    cycle_s: float
    began_at: float | None

    def is_over(self, at: float) -> bool:
        return self._cycle(at) >= len(self.mpp_kw)

    def available_kw(self, position: int) -> Callable[[float], float]:
        return lambda at: float(self.mpp_kw[min(self._cycle(at), len(self.mpp_kw) - 1), position])

    def _cycle(self, at: float) -> int:
        return 0 if self.began_at is None else max(int((at - self.began_at) / self.cycle_s), 0)


@contextmanager
def served(
    simulated: Mapping[str, LimitedInverter | SetStorage],
    sky: Sky,
    now: Callable[[], float],
    host: str = "127.0.0.1",
    port: int = 0,
    *,
    points: Callable[[LimitedInverter, float], Points] = inverter_points,
) -> Iterator[dict[str, str]]:
    """Serve devices by their paths, and the `meter`, in a thread; gives the addresses by name.

    sky: Begins with the first write, unless it has begun already.
    host, port: Where to listen. Port 0: any that is free.
    points: Returns the points of an inverter's models at a time.
    """
    names = [*simulated, "meter"]
    if len(names) > _MOST_UNITS:
        expected = f"expected up to {_MOST_UNITS - 1} at one port"
        raise InputError.of("inverters", f"{expected}, got {len(simulated)}")

    def begin_sky() -> None:
        sky.began_at = now() if sky.began_at is None else sky.began_at

    def device(unit: int, name: str) -> SimDevice:
        if name == "meter":
            return meter_device(unit, simulated.values(), now)
        shown = storage_points if isinstance(simulated[name], SetStorage) else points
        return commanded_device(unit, name, simulated[name], now, begin_sky, shown)

    devices = {name: device(unit, name) for unit, name in enumerate(names, start=1)}
    with in_thread(listening(devices, host, port)) as addresses:
        yield addresses


@contextmanager
def in_thread(context: AbstractAsyncContextManager[T]) -> Iterator[T]:
    """Enter an asynchronous context, whose event loop runs in a thread of its own."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    try:
        found = asyncio.run_coroutine_threadsafe(context.__aenter__(), loop).result()
        try:
            yield found
        finally:
            asyncio.run_coroutine_threadsafe(context.__aexit__(None, None, None), loop).result()
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


@asynccontextmanager
async def listening(
    devices: Mapping[str, SimDevice], host: str, port: int
) -> AsyncIterator[dict[str, str]]:
    """Serve devices at one port; gives their addresses by name."""
    server = ModbusTcpServer([*devices.values(), no_unit()], address=(host, port))
    try:
        await server.serve_forever(background=True)
    except (RuntimeError, OverflowError):  # No port is above 65535.
        expected = "an address and free port of this machine"
        raise InputError.of("--address", f"expected {expected}, got {host} port {port}") from None
    try:
        assert isinstance(server.transport, asyncio.Server)
        found = server.transport.sockets[0].getsockname()[1]
        yield {name: f"modbus://{host}:{found}/{device.id}" for name, device in devices.items()}
    finally:
        await server.shutdown()
