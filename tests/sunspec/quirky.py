"""A device over Modbus TCP that behaves as real ones do, and as the standard does not say."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, Self

from sunspec2.device import Model

from sunspec.registers import NO_MEMBERS

RATING_W, SUN_W = 100_000.0, 80_000.0

LIMITS = ("WMaxLimPct", "WMaxLimPct_RvrtTms", "WMaxLim_Ena")

Answers = Callable[[int, bytes], list[bytes]]
"""From the number of a request and its answer: what is sent."""


def integers(**changes: Any) -> dict[int, dict[str, Any]]:
    """Points of an inverter with models 103, 120, 122 and 123."""
    measured = {"W_SF": 1, "A_SF": 0, "V_SF": 0, "Hz_SF": -2, "WH_SF": 0, "Tmp_SF": 0, "St": 4}
    limits = {"WMaxLimPct_SF": -2, "WMaxLimPct": 10_000, "WMaxLim_Ena": 0, "WMaxLimPct_RvrtTms": 0}
    return {
        1: {"Mn": "Acme", "Md": "Quirk", "SN": "1", "Vr": "1", "DA": 1},
        103: {**measured, "W": 0} | changes.get("measured", {}),
        120: {"WRtg_SF": 1, "WRtg": 10_000},
        123: limits | changes.get("limits", {}),
    }


def storage(**changes: Any) -> dict[int, dict[str, Any]]:
    """Points of a storage of 100 kW and 50 kWh that stays at 0 W; None: not implemented."""
    no_order = {"WSetEna": 0, "WSetMod": 1, "WSet": 0, "WSetRvrt": 0, "WSetEnaRvrt": 0}
    half = {"WH_SF": 1, "Pct_SF": 0, "WHRtg": 5_000, "SoC": 50, "Sta": 0}
    return {
        1: {"Mn": "Acme", "Md": "Quirk", "SN": "1", "Vr": "1", "DA": 1},
        701: {"W_SF": 0, "W": 0, "InvSt": 3},
        702: {"W_SF": 1, "WMax": 10_000, "WMaxRtg": 10_000},
        704: {"WSet_SF": 0, "WSetRvrtTms": 0, **no_order} | changes.get("control", {}),
        713: half | changes.get("store", {}),
    }


@dataclass
class Quirky:
    """Serves models from a register on, as long as the context lasts.

    functions: Those that it answers; `refuses`: it refuses the others instead of saying nothing.
    answers: What it sends; a closed connection where that is empty.
    obeys: Whether it follows the limits that it acknowledges.
    power_w: What it states; None: nothing, as inverters do at night.
    """

    models: Mapping[int, Mapping[str, Any]] = field(default_factory=integers)
    first: int = 40_000
    functions: frozenset[int] = frozenset({3, 6, 16})
    refuses: bool = False
    refused: Callable[[int, str], bool] = lambda function, point: False
    """Whether it refuses to write a point by a function."""
    answers: Answers = lambda number, answer: [answer]
    echoes: bool = True
    obeys: bool = True
    slow_s: float = 0.0
    ends: bool = True
    low_first: bool = False
    """Whether the low register of a float comes first."""
    power_w: float | None = SUN_W
    writes: list[tuple[int, int, int]] = field(default_factory=list)
    """Function, first register and number of registers of each write."""
    requests: int = 0

    def __enter__(self) -> Self:
        self._models = {number: Model(number, data=NO_MEMBERS) for number in self.models}
        self._at: dict[int, int] = {}
        image = b"SunS"
        for number, points in self.models.items():
            self._at[number] = self.first + len(image) // 2
            self._models[number].set_dict(dict(points))
            image += self._models[number].get_mb()
        self._end = self.first + len(image) // 2
        self._server = socket.create_server(("127.0.0.1", 0))
        self.address = f"modbus://127.0.0.1:{self._server.getsockname()[1]}/1"
        self._open = [self._server]
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        for one in self._open:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def register(self, number: int, name: str) -> int:
        return self._at[number] + int(self._models[number].points[name].offset)

    def state(self, model: int = 103, **values: Any) -> None:
        for name, value in values.items():
            self._models[model].points[name].value = value

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._server.accept()
                self._open.append(connection)
                threading.Thread(target=self._serve, args=[connection], daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with suppress(OSError, struct.error), connection:
            while True:
                head = connection.recv(7, socket.MSG_WAITALL)
                number, _, length, unit = struct.unpack(">HHHB", head)
                request = connection.recv(length - 1, socket.MSG_WAITALL)
                time.sleep(self.slow_s)
                answer = self._answer(request)
                if answer is None:
                    continue
                self.requests += 1
                sent = self.answers(self.requests, answer)
                if not sent:
                    return
                for one in sent:
                    told = number if self.echoes else (number + 7) % 65_536
                    connection.sendall(struct.pack(">HHHB", told, 0, len(one) + 1, unit) + one)

    def _answer(self, request: bytes) -> bytes | None:
        function, first, count = struct.unpack(">BHH", request[:5])
        if function not in self.functions:
            return bytes([function | 0x80, 1]) if self.refuses else None
        if function == 3:
            image = self._image()[2 * (first - self.first) :] if first >= self.first else b""
            if len(image) < 2 * count:
                return bytes([0x83, 2])
            return bytes([3, 2 * count]) + image[: 2 * count]
        words = request[6:] if function == 16 else request[3:5]
        limits = LIMITS if 123 in self._models else ()
        places = {name: self.register(123, name) - first for name in limits}
        written = [name for name, place in places.items() if 0 <= place < len(words) // 2]
        if any(self.refused(function, name) for name in written):
            return bytes([function | 0x80, 2])
        self.writes.append((function, first, len(words) // 2))
        for number, model in self._models.items():
            for point in model.points.values():
                place = self._at[number] + point.offset - first
                if 0 <= place < len(words) // 2 and number in {123, 704, 715}:
                    point.set_mb(words[2 * place : 2 * (place + point.len)])
        return request[:5]

    def _image(self) -> bytes:
        limited = self._models.get(123)
        power_w = self.power_w
        if limited is not None and self.obeys and limited.points["WMaxLim_Ena"].value == 1:
            scale = limited.points["WMaxLimPct_SF"].value
            percent = limited.points["WMaxLimPct"].value * 10.0**scale
            limit_w = percent / 100.0 * RATING_W
            power_w = None if power_w is None else min(power_w, limit_w)
        for number in {103, 113, 213} & self._models.keys():
            is_whole = number == 103 and power_w is not None
            value = round(power_w / 10.0) if is_whole and power_w is not None else power_w
            self._models[number].points["W"].value = value
        image = b"SunS" + b"".join(self._words(model) for model in self._models.values())
        return image + (b"\xff\xff\x00\x00" if self.ends else b"")

    def _words(self, model: Model) -> bytes:
        words = bytearray(model.get_mb())
        for point in model.points.values() if self.low_first else ():
            if point.len == 2:
                at = 2 * point.offset
                words[at : at + 4] = words[at + 2 : at + 4] + words[at : at + 2]
        return bytes(words)


@contextmanager
def quirky(**quirks: Any) -> Iterator[Quirky]:
    with Quirky(**quirks) as found:
        yield found
