"""Where the plant's process takes orders from programs of the user who runs it.

A socket in the run's folder that its owner alone may open. Who connects sends orders, one in a
packet, and hears in each cycle what the plant does.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, Self

import msgspec

from agents.agent import Turn
from bus_schemas.bounds import bounds_of, is_within
from bus_schemas.bus import Delivery
from bus_schemas.errors import InputError
from bus_schemas.messages import Dispatch, Meter, Order, Production
from bus_schemas.signals import ORDER
from bus_schemas.tree import PLANT, ROOT
from sim_plant.inverters import PlantState
from sim_plant.plant import Plant

SOCKET_NAME: Final = "orders.sock"
TAKEN: Final = "taken"

_MOST_CLIENTS: Final = 16
_LARGEST_BYTES: Final = 4_096

_SOURCES: Final = {"command", "page", "modbus"}
_BOUNDS: Final = bounds_of(Order, 1.0)


class PlantStatus(msgspec.Struct, frozen=True, kw_only=True):
    """What the plant was asked for and did in a cycle. Powers in kW.

    answer: To the client that hears this: `taken` if its order came into force in the cycle, or
        why an order of it did not; empty if there was none.
    """

    dispatch: Dispatch
    available_kw: float
    delivered_kw: float
    frequency_hz: float | None = None
    answer: str = ""


class OrderDesk:
    """The plant's end of the socket. Nothing here waits."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.absolute()
        self._answers: dict[socket.socket, str] = {}
        """Clients, with the answer that each hears at the end of the cycle."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)

    def __enter__(self) -> Self:
        mask = os.umask(0o177)  # It never has another mode.
        try:
            with short_path(self._folder) as path:
                self._socket.bind(path)
        finally:
            os.umask(mask)
        self._socket.listen(_MOST_CLIENTS)
        return self

    def __exit__(self, *error: object) -> None:
        for one in (self._socket, *self._answers):
            one.close()
        (self._folder / SOCKET_NAME).unlink(missing_ok=True)

    def take(self) -> Order | None:
        with suppress(BlockingIOError):
            while len(self._answers) < _MOST_CLIENTS:
                client, _ = self._socket.accept()
                client.setblocking(False)
                self._answers[client] = ""
        newest, giver = None, None
        for client in [*self._answers]:
            for given in self._given_by(client):
                if giver is not None:
                    self._answers[giver] = f"replaced at once by an order of {given.source}"
                newest, giver = given, client
                self._answers[client] = TAKEN
        return newest

    def tell(self, status: PlantStatus) -> None:
        """Tell the clients what the plant did; one that does not read in time misses it."""
        for client, answer in [*self._answers.items()]:
            answered = msgspec.structs.replace(status, answer=answer)
            self._answers[client] = ""
            with suppress(BlockingIOError):
                try:
                    client.send(msgspec.json.encode(answered))
                except (BrokenPipeError, ConnectionResetError):
                    self._forget(client)

    def _given_by(self, client: socket.socket) -> Iterator[Order]:
        packet = b"-"
        while packet:
            try:
                packet = client.recv(_LARGEST_BYTES)
                if packet:
                    yield _read_order(packet)
            except BlockingIOError:
                return
            except ConnectionResetError:
                break
            except msgspec.DecodeError as error:
                self._answers[client] = f"refused: {error}"
        self._forget(client)

    def _forget(self, client: socket.socket) -> None:
        del self._answers[client]
        client.close()


def _read_order(packet: bytes) -> Order:
    """Read an order of a program. Raises DecodeError: It is none."""
    order = msgspec.json.decode(packet, type=Order)
    if order.source not in _SOURCES or not is_within(order, _BOUNDS):
        raise msgspec.ValidationError("its source, or a number of it, cannot be")
    return order


class PlantAtDesk:
    """A plant that also takes the orders of a desk."""

    name = PLANT
    may_skip = False

    def __init__(self, plant: Plant, desk: OrderDesk) -> None:
        self._plant, self._desk = plant, desk
        self._frequency_hz: float | None = None
        self.initial_state, self.stages = plant.initial_state, plant.stages

    def step(self, state: PlantState, turn: Turn) -> tuple[PlantState, list[Delivery]]:
        if turn.stage == "sense" and turn.cycle >= 0 and (order := self._desk.take()):
            turn = msgspec.structs.replace(turn, inputs=turn.inputs | {ORDER.of(ROOT): order})
        state, outputs = self._plant.step(state, turn)
        for _, message in outputs:
            if isinstance(message, Meter):
                self._frequency_hz = message.frequency_hz
            if isinstance(message, Production) and turn.cycle >= 0:
                status = PlantStatus(
                    dispatch=state.dispatch,
                    available_kw=message.available_kw,
                    delivered_kw=message.delivered_kw,
                    frequency_hz=self._frequency_hz,
                )
                self._desk.tell(status)
        return state, outputs


class OrderLine:
    """A program's end of the socket in a run's folder.

    Raises InputError: The folder has no run that takes orders.
    """

    def __init__(self, folder: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            with short_path(folder.absolute()) as path:
                self._socket.connect(path)
        except (FileNotFoundError, ConnectionRefusedError):
            raise InputError(
                f"{folder}: expected a run under way that `launch` has begun"
            ) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._socket.close()

    def fileno(self) -> int:
        return self._socket.fileno()

    def give(
        self,
        source: str,
        *,
        power_kw: float | None,
        ramp_kw_per_min: float | None = None,
        hold_s: float | None = None,
        renew_s: float | None = None,
    ) -> None:
        """Send an order, see `Order`; the plant answers at the end of its next cycle."""
        order = Order(
            *(0, 0, source, ()),
            power_kw=power_kw,
            ramp_kw_per_min=ramp_kw_per_min,
            hold_s=hold_s,
            renew_s=renew_s,
        )
        self._socket.send(msgspec.json.encode(order))

    def statuses(self) -> Iterator[PlantStatus]:
        """Yield what the plant does, cycle by cycle, until the run is over."""
        with suppress(ConnectionResetError):
            while packet := self._socket.recv(_LARGEST_BYTES):
                yield msgspec.json.decode(packet, type=PlantStatus)


@contextmanager
def short_path(folder: Path) -> Iterator[str]:
    """Give a path of the socket: a socket's own path may have 107 characters at most."""
    number = os.open(folder, os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{number}/{SOCKET_NAME}"
    finally:
        os.close(number)
