"""Requests to one unit over Modbus TCP. An answer that is not that of its request is no reading."""

from __future__ import annotations

import socket
import struct
import time
from contextlib import suppress
from typing import Final

READ: Final = 3
WRITE_SEVERAL: Final = 16

_MOST_REGISTERS: Final = 125
_HEAD: Final = struct.Struct(">HHHB")
_EXCEPTION: Final = 0x80
_EXCEPTIONS: Final = {
    1: "illegal function",
    2: "illegal address",
    3: "illegal value",
    4: "device failure",
    5: "acknowledged, not done yet",
    6: "busy",
    10: "gateway path unavailable",
    11: "gateway got no answer",
}


_OF_KIND: Final = frozenset({1, 2, 3})
_GATEWAY_EXCEPTIONS: Final = frozenset({10, 11})
_PASSING: Final = frozenset({5, 6, 10, 11})


class DeviceError(Exception):
    """A device does not answer, or not as it must; the text is one line."""


class DeviceRefusedError(DeviceError):
    """A device answers that it does not do what is asked; the connection stays.

    is_of_kind: Whether it does not know such a request.
    is_passing: Whether it is busy, or was not reached, and may do it the next time.
    """

    is_of_kind = is_passing = False


class LinkClosedError(DeviceError):
    """A device has closed the connection."""


class NoAnswerError(DeviceError):
    """A device has not answered in time."""


class WrongAnswerError(DeviceError):
    """What came is not the answer to the request; the link has hung up."""


class ModbusLink:
    """The connection to one unit.

    A request on a connection that the device has closed is made once more on a new one.

    drops: How often the device has closed the connection.
    """

    def __init__(self, address: str, host: str, port: int, unit: int, timeout_s: float) -> None:
        self.drops = 0
        self._address, self._peer, self._unit = address, (host, port), unit
        self._timeout_s = timeout_s
        self._socket: socket.socket | None = None
        self._number = 0
        self._echoes: bool | None = None
        """Whether the device repeats the numbers of requests: some gateways never do."""

    def open(self) -> None:
        """Connect. Raises DeviceError: Nothing listens there."""
        self.close()
        try:
            self._socket = socket.create_connection(self._peer, self._timeout_s)
        except OSError as error:
            raise self._error(DeviceError, f"no connection: {error.strerror or error}") from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def read(self, first: int, count: int) -> bytes:
        """Return the contents of registers."""
        found = b""
        for begin in range(first, first + count, _MOST_REGISTERS):
            number = min(first + count - begin, _MOST_REGISTERS)
            answer = self._ask(struct.pack(">BHH", READ, begin, number))
            if answer[0] != 2 * number or len(answer) != 1 + 2 * number:
                raise self._wrong(f"{len(answer) - 1} bytes for {2 * number}")
            found += answer[1:]
        return found

    def write(self, first: int, data: bytes, function: int) -> None:
        """Write registers: several at once, or one after the other with function 6."""
        if function == WRITE_SEVERAL:
            head = struct.pack(">HH", first, len(data) // 2)
            answer = self._ask(bytes([function]) + head + bytes([len(data)]) + data)
            if answer != head:
                raise self._wrong("other registers than those that were written")
            return
        for place in range(0, len(data), 2):
            head = struct.pack(">H", first + place // 2)
            answer = self._ask(bytes([function]) + head + data[place : place + 2])
            if answer[:2] != head or len(answer) != 4:  # Some repeat the value as they round it.
                raise self._wrong("another register than the one that was written")

    def _ask(self, request: bytes) -> bytes:
        """Return the answer to a request, without its function. Raises DeviceError."""
        try:
            return self._ask_once(request)
        except LinkClosedError:
            self.open()
            self.drops += 1
            return self._ask_once(request)

    def _ask_once(self, request: bytes) -> bytes:
        self._number = self._number % 65_535 + 1
        until = time.monotonic() + self._timeout_s
        try:
            self._refuse_leftovers()
            connection = self._connection()
            connection.settimeout(self._timeout_s)
            head = _HEAD.pack(self._number, 0, len(request) + 1, self._unit)
            connection.sendall(head + request)
            number, protocol, length, unit = _HEAD.unpack(self._receive(_HEAD.size, until))
            if protocol or not 3 <= length <= 256:
                raise self._wrong("what is no Modbus TCP")
            answer = self._receive(length - 1, until)
        except TimeoutError:
            self.close()
            what = f"no answer to function {request[0]} within {self._timeout_s:g} s"
            raise self._error(NoAnswerError, what) from None
        except OSError:
            raise self._closed() from None
        self._check_number(number)
        function, code = answer[0], answer[1]
        if unit != self._unit or function & ~_EXCEPTION != request[0]:
            raise self._wrong(f"unit {unit}, function {function}")
        if function & _EXCEPTION:
            register = int.from_bytes(request[1:3])
            if code in _GATEWAY_EXCEPTIONS:  # The answer may still come.
                self.close()
            what = f"exception {code} ({_EXCEPTIONS.get(code, 'unknown')})"
            text = f"{what} of unit {unit} to function {request[0]} at register {register}"
            refusal = DeviceRefusedError(f"{self._address}: {text}")
            refusal.is_of_kind, refusal.is_passing = code in _OF_KIND, code in _PASSING
            raise refusal
        return answer[1:]

    def _check_number(self, number: int) -> None:
        if self._echoes is None:
            self._echoes = number == self._number
        if self._echoes and number != self._number:
            raise self._wrong(f"request {number} for {self._number}")

    def _connection(self) -> socket.socket:
        if self._socket is None:
            self.open()
        assert self._socket is not None
        return self._socket

    def _receive(self, count: int, until: float) -> bytes:
        connection, found = self._connection(), b""
        while len(found) < count:
            connection.settimeout(max(until - time.monotonic(), 1e-3))
            part = connection.recv(count - len(found))
            if not part:
                raise self._closed()
            found += part
        return found

    def _refuse_leftovers(self) -> None:
        """Hang up if something came that no request asked for: it would be taken for an answer."""
        connection = self._connection()
        connection.setblocking(False)
        with suppress(BlockingIOError):
            if connection.recv(1):
                raise self._wrong("an answer without a request")
            raise self._closed()

    def _closed(self) -> LinkClosedError:
        self.close()
        return LinkClosedError(f"{self._address}: connection closed by the device")

    def _wrong(self, got: str) -> DeviceError:
        self.close()
        what = "expected the answer to the request, got"
        return self._error(WrongAnswerError, f"{what} {got}; hung up")

    def _error(self, kind: type[DeviceError], text: str) -> DeviceError:
        return kind(f"{self._address}: {text}")
