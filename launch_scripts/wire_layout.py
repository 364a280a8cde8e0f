"""The part of `docs/wire.md` about msgpack: its rules, and messages taken apart byte by byte."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from bus_schemas.codec import encode
from bus_schemas.messages import (
    Command,
    HelpGiven,
    Impp,
    Message,
    Residual,
    Run,
    Setpoint,
    Telemetry,
)
from bus_schemas.tree import PLANT

INVERTER: Final = "c2/inv07"

_RULES: Final = """\
## Byte by byte

A reader has to accept a map's fields in any order and integers in any of msgpack's widths. It must
refuse a field that it does not know, a missing one (`ready_time_ns`, `publish_time_ns` and
`sequence` may be left out: 0; so may a field of which the tables say so), and bytes after the map.
A writer may use these:

| value | msgpack |
|---|---|
| map of up to 15 fields | `80` + number of fields, then name and value of each |
| string of up to 31 bytes, of up to 255 | `a0` + length; `d9` length; then UTF-8. Not `bin` |
| array of up to 15 entries, of more | `90` + length; `dc` length (2 bytes); then the entries |
| integer 0 to 127, -32 to -1 | the byte itself |
| unsigned of 1, 2, 4, 8 bytes | `cc`, `cd`, `ce`, `cf`, then big-endian |
| signed of 1, 2, 4, 8 bytes | `d0`, `d1`, `d2`, `d3`, then big-endian |
| float 64 | `cb`, then IEEE 754 big-endian; `ca` (float 32) and integers are read as well |
| boolean | `c2` no, `c3` yes |
| nil | `c0`, only where the tables say so |

An integer field takes no float.

"""


def layout() -> Iterator[str]:
    """Yield the lines about msgpack, byte by byte."""
    yield from _RULES.splitlines()
    for title, message in _examples():
        yield title
        yield ""
        yield "| bytes (hex) | what they are |"
        yield "|---|---|"
        for part in _parts(encode(message)):
            yield f"| `{part.data.hex(' ')}` | {part.meaning} |"
        yield ""


def _examples() -> Iterator[tuple[str, Message]]:
    time_ns = 1_270_159_202_000_000_000
    yield (
        "Telemetry of `c2/inv07` in cycle 2, after 120.5 kW at alpha 0.5:",
        Telemetry(
            2,
            time_ns,
            PLANT,
            (),
            4_999_900_000,
            5_000_000_000,
            2,
            power_kw=120.5,
            alpha=0.5,
            limit_kw=470.0,
        ),
    )
    yield (
        "IMPP of `c2/inv07` in an arming round, so with a negative cycle and number 0:",
        Impp(
            -999_999,
            time_ns - 1_000_001_000_000_000,
            INVERTER,
            (),
            3_999_900_000,
            4_000_000_000,
            0,
            power_kw=241.0,
            stale_cycles=0,
        ),
    )
    yield (
        "Residual in a cycle whose dispatch had not come in time: that of cycle 1 was used:",
        Residual(
            2,
            time_ns,
            INVERTER,
            ("dispatch@1",),
            5_002_900_000,
            5_003_000_000,
            2,
            power_kw=-20.0,
        ),
    )
    yield (
        "Setpoint of 100 kW: the share of 80 kW, and 20 kW more for `c2/inv05`:",
        Setpoint(
            2,
            time_ns,
            "c2",
            (),
            5_003_400_000,
            5_003_500_000,
            2,
            power_kw=100.0,
            share_kw=80.0,
            help_given=(HelpGiven("c2/inv05", 20.0),),
        ),
    )
    yield (
        "The command that answers it:",
        Command(
            2,
            time_ns,
            INVERTER,
            (),
            5_003_900_000,
            5_004_000_000,
            2,
            alpha=100.0 / 241.0,
            power_kw=100.0,
        ),
    )
    yield (
        "The plant's word that the run begins, in real time with 1 s a cycle:",
        Run(
            0,
            time_ns - 2_000_000_000,
            PLANT,
            (),
            2_799_900_000,
            2_800_000_000,
            0,
            state="start",
            start_time_ns=3_000_000_000,
            cycle_wall_ns=1_000_000_000,
        ),
    )


@dataclass(frozen=True, slots=True)
class _Part:
    data: bytes
    meaning: str


def _parts(payload: bytes) -> Iterator[_Part]:
    """Take a message apart: its head, then names, values and entries as they follow each other."""
    yield _Part(payload[:1], f"a map of {payload[0] & 0x0F} entries")
    place = 1
    while place < len(payload):
        part = _value(payload, place)
        yield part
        place += len(part.data)


_NIL: Final = 0xC0
_FIXED: Final = {
    0xCB: (8, ">d", "float 64"),
    0xCC: (1, ">B", "unsigned integer of 1 byte"),
    0xCD: (2, ">H", "unsigned integer of 2 bytes"),
    0xCE: (4, ">I", "unsigned integer of 4 bytes"),
    0xCF: (8, ">Q", "unsigned integer of 8 bytes"),
    0xD2: (4, ">i", "signed integer of 4 bytes"),
}


def _value(payload: bytes, place: int) -> _Part:
    first = payload[place]
    if first in _FIXED:
        length, layout, name = _FIXED[first]
        data = payload[place : place + 1 + length]
        return _Part(data, f"{name}: {struct.unpack(layout, data[1:])[0]!r}")
    if first < 0x80:
        return _Part(payload[place : place + 1], f"integer {first}")
    if 0xA0 <= first < 0xC0:
        data = payload[place : place + 1 + (first & 0x1F)]
        return _Part(data, f'string "{data[1:].decode()}"')
    if first == _NIL:
        return _Part(payload[place : place + 1], "nil")
    if 0x90 <= first < 0xA0:
        return _Part(payload[place : place + 1], f"an array of {first & 0x0F} entries")
    raise ValueError(f"no example has the msgpack type {first:#x}")
