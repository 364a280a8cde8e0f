"""Where the plant's process takes orders from programs of the user who runs it.

A socket in the run's folder that its owner alone may open. Who connects sends orders, one in a
packet. Each order gets one reply, as the next cycle begins; a program hears in every cycle what the
plant does. The orders of the desk and those that came by the bus stand in one queue.
"""

from __future__ import annotations

import os
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, NamedTuple, Self, TypeAlias

import msgspec

from agents.agent import Turn
from bus_schemas.bounds import bounds_of
from bus_schemas.bus import Delivery
from bus_schemas.codec import UNREADABLE
from bus_schemas.errors import FailureError, InputError, printable
from bus_schemas.messages import Dispatch, Meter, Order, Production
from bus_schemas.signals import ORDER
from bus_schemas.tree import PLANT, ROOT
from sim_plant.inverters import PlantState
from sim_plant.orders import COMMAND, GIVERS, MODBUS, PAGE, replaced_text
from sim_plant.plant import Plant

SOCKET_NAME: Final = "orders.sock"

_MOST_CLIENTS: Final = 64
_LARGEST_BYTES: Final = 8_192

_MOST_ORDERS: Final = 1_000
"""How many orders of one program may be open, without a reply that it has read."""

_MOST_STATUSES: Final = 10
"""How many packets may wait for a program, until it misses what the plant does."""

_RETRY_S: Final = 0.05
_SILENCE_S: Final = 60.0
"""A program gives up on a plant that says nothing for this time and some cycles."""


class Reply(msgspec.Struct, frozen=True, kw_only=True, tag="reply"):
    """What became of an order: `in force from cycle 90`, `replaced by the page in cycle 90`.

    is_in_force: Whether it came into force.
    """

    text: str
    is_in_force: bool = False


class PlantStatus(msgspec.Struct, frozen=True, kw_only=True, tag="status"):
    """What the plant was asked for and did in a cycle. Powers in kW."""

    dispatch: Dispatch
    available_kw: float
    delivered_kw: float
    frequency_hz: float | None = None


FromPlant: TypeAlias = Reply | PlantStatus


class _Client:
    """A program at the desk, and what it is still to be sent.

    owed: How many orders of it have no reply that was sent.
    """

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        self.connection = connection
        self.owed = 0
        self._outbox: deque[tuple[bytes, bool]] = deque()

    @property
    def awaits(self) -> int:
        """What the desk waits for: its orders, unless too many are open, and that it reads."""
        reads = select.POLLIN if self.owed < _MOST_ORDERS else 0
        return reads | (select.POLLOUT if self._outbox else 0)

    def packets(self) -> Iterator[bytes]:
        """Yield the packets that have come; the last one is empty if the program has gone."""
        packet = b"-"
        while packet and self.owed < _MOST_ORDERS:
            try:
                packet = self.connection.recv(_LARGEST_BYTES)
            except ConnectionResetError:  # It has gone without reading all; its orders still count.
                continue
            except BlockingIOError:
                return
            except OSError:
                packet = b""
            self.owed += 1
            yield packet

    def reply(self, text: str, *, is_in_force: bool = False) -> None:
        reply = Reply(text=text, is_in_force=is_in_force)
        self._outbox.append((msgspec.json.encode(reply), True))

    def tell(self, status: bytes) -> None:
        """Let it hear what the plant did; one that does not read misses that."""
        if len(self._outbox) < _MOST_STATUSES:
            self._outbox.append((status, False))

    def send(self) -> None:
        try:
            while self._outbox:
                packet, is_reply = self._outbox[0]
                self.connection.send(packet)
                self._outbox.popleft()
                self.owed -= is_reply
        except BlockingIOError:
            pass
        except OSError:  # It has gone, and will be seen to have gone when it is next read.
            self._outbox.clear()
            self.owed = 0


class _Queued(NamedTuple):
    """An order, and the program at the desk that gave it; None: it came by the bus."""

    order: Order
    giver: _Client | None


class OrderDesk:
    """The plant's end of the socket, with a thread that serves it: the plant never waits.

    A wrong order is refused at once, all others stand in a queue until the plant takes them.
    """

    def __init__(self, folder: Path, rating_kw: float) -> None:
        self._folder = folder.absolute()
        self._bounds = [
            bound._replace(low=0.0, high=rating_kw) if bound.field == "power_kw" else bound
            for bound in bounds_of(Order, rating_kw)
        ]
        self._clients: list[_Client] = []
        self._queue: deque[_Queued] = deque()
        self._taken: list[_Queued] = []
        self._last_status = b""
        self._is_over = False
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._serve, name="order desk", daemon=True)

    def __enter__(self) -> Self:
        mask = os.umask(0o177)  # Create the socket with mode 0600 from the start.
        try:
            with short_path(self._folder) as path:
                self._socket.bind(path)
        finally:
            os.umask(mask)
        self._socket.listen(_MOST_CLIENTS)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        (self._folder / SOCKET_NAME).unlink(missing_ok=True)
        self._is_over = True
        os.eventfd_write(self._wake, 1)
        self._thread.join()
        self._look()
        for _, giver in (*self._taken, *self._queue):
            if giver is not None:
                giver.reply("refused: the run is over")
        for client in self._clients:
            client.send()
            client.connection.close()
        self._socket.close()
        os.close(self._wake)

    def take(self, others: tuple[Order, ...] = ()) -> tuple[Order, ...]:
        """Return the orders that have come to the desk and others, in the order of time."""
        taken = [_Queued(order, None) for order in others]
        while self._queue:
            taken.append(self._queue.popleft())
        self._taken = sorted(taken, key=lambda one: one.order.publish_time_ns)
        return tuple(one.order for one in self._taken)

    def answer(self, dispatch: Dispatch) -> None:
        """Say to the givers of the orders that were taken last what the dispatch made of them."""
        newest = GIVERS.get(dispatch.order_source, dispatch.order_source)
        for order, giver in self._taken:
            if giver is None:
                continue
            if order is self._taken[-1].order:
                text = f"in force from cycle {dispatch.order_cycle:,}{replaced_text(dispatch)}"
                giver.reply(text, is_in_force=True)
            else:
                giver.reply(f"replaced by {newest} in cycle {dispatch.cycle:,}")
        if self._taken:
            os.eventfd_write(self._wake, 1)
        self._taken = []

    def tell(self, status: PlantStatus) -> None:
        """Tell all programs what the plant did."""
        self._last_status = msgspec.json.encode(status)
        for client in (clients := [*self._clients]):
            client.tell(self._last_status)
        if clients:
            os.eventfd_write(self._wake, 1)

    def _serve(self) -> None:
        """Serve the socket, in the desk's thread, until the run is over."""
        while not self._is_over:
            poll = select.poll()
            poll.register(self._wake, select.POLLIN)
            if len(self._clients) < _MOST_CLIENTS:
                poll.register(self._socket, select.POLLIN)
            for client in self._clients:
                if client.awaits:
                    poll.register(client.connection, client.awaits)
            poll.poll()
            with suppress(BlockingIOError):
                os.eventfd_read(self._wake)
            self._look()

    def _look(self) -> None:
        """Take in who comes and what they say; send what they are to hear."""
        try:
            while len(self._clients) < _MOST_CLIENTS:
                client = _Client(self._socket.accept()[0])
                if self._last_status:
                    client.tell(self._last_status)
                self._clients.append(client)
        except BlockingIOError:
            pass  # Nobody else waits.
        except OSError:  # The process has too many open files: try again, but not at once.
            time.sleep(_RETRY_S)
        for client in [*self._clients]:
            for packet in client.packets():
                try:
                    self._queue.append(_Queued(self._read(packet), client))
                except (*UNREADABLE, InputError) as error:
                    client.reply(f"refused: {printable(str(error))}")
                if not packet:
                    client.send()
                    client.connection.close()
                    self._clients.remove(client)
                    break
            else:
                client.send()

    def _read(self, packet: bytes) -> Order:
        """Read an order of a program. Raises UNREADABLE or InputError: It is none."""
        order = msgspec.json.decode(packet, type=Order)
        if order.source not in {COMMAND, PAGE, MODBUS}:
            expected = f"{COMMAND}, {PAGE} or {MODBUS}"
            raise InputError(f"source: expected {expected}, got {order.source!r}")
        for bound in self._bounds:
            value = getattr(order, bound.field)
            if value is not None and not bound.low <= value <= bound.high:
                raise InputError(f"{bound.field}: expected {bound}, got {value:.10g}")
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
        takes_orders = turn.stage == "sense" and turn.cycle >= 0
        if takes_orders:
            port = ORDER.of(ROOT)
            orders: dict[Any, Any] = {port: self._desk.take(turn.inputs[port])}
            turn = msgspec.structs.replace(turn, inputs=turn.inputs | orders)
        state, outputs = self._plant.step(state, turn)
        if takes_orders:
            self._desk.answer(state.dispatch)
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

    cycle_s: Wall time of a cycle [s].

    Raises InputError: The folder has no run that takes orders.
    """

    def __init__(self, folder: Path, cycle_s: float = 0.0) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.settimeout(_SILENCE_S + 3.0 * cycle_s)
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
        self.close()

    def close(self) -> None:
        self._socket.close()

    def give(
        self,
        source: str,
        *,
        power_kw: float | None,
        ramp_kw_per_min: float | None = None,
        hold_s: float | None = None,
        renew_s: float | None = None,
    ) -> None:
        """Send an order, see `Order`. Its reply comes as the plant's next cycle begins.

        Raises FailureError: The run is over.
        """
        order = Order(
            *(0, 0, source, ()),
            publish_time_ns=time.monotonic_ns(),
            power_kw=power_kw,
            ramp_kw_per_min=ramp_kw_per_min,
            hold_s=hold_s,
            renew_s=renew_s,
        )
        try:
            self._socket.send(msgspec.json.encode(order))
        except OSError:
            raise FailureError("order: expected a run under way, the plant is gone") from None

    def heard(self) -> Iterator[FromPlant]:
        """Yield what the plant says, until the run is over.

        Raises FailureError: It is silent.
        """
        decoder: msgspec.json.Decoder[FromPlant] = msgspec.json.Decoder(FromPlant)
        while True:
            try:
                packet = self._socket.recv(_LARGEST_BYTES)
            except ConnectionResetError:  # The plant is gone; what it said before can be read.
                continue
            except TimeoutError:
                raise FailureError("order: the plant has said nothing for a minute") from None
            if not packet:
                return
            yield decoder.decode(packet)


@contextmanager
def short_path(folder: Path) -> Iterator[str]:
    """Give a path of the socket: a socket's own path may have 107 characters at most."""
    number = os.open(folder, os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{number}/{SOCKET_NAME}"
    finally:
        os.close(number)
