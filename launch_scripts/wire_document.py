"""Writes `docs/wire.md`: all that a foreign program needs to take an agent's place on the bus.

    .venv/bin/python -m launch_scripts.wire_document > docs/wire.md

Keys, types, layouts and stages are read from the table of signals, the message types and the agents
themselves, so the document cannot differ from what runs. A test holds the file to it.
"""

from __future__ import annotations

import inspect
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from msgspec.structs import fields

from agents.central import CentralController
from agents.deadlines import USED_SHARE, stage_place
from agents.direct import DirectController
from agents.family import Family
from agents.periods import Periods
from agents.supervisor import Supervisor
from bus_schemas.codec import encode
from bus_schemas.messages import Command, Message, Telemetry
from bus_schemas.signals import SIGNALS
from bus_schemas.tree import CENTRAL, PLANT, ROOT, ControlTree

_INVERTER: Final = "c1/inv07"
_TREE: Final = ControlTree((("c1/inv01", 470.0), (_INVERTER, 470.0), ("c2/inv02", 470.0)))
_UNITS: Final = {"_kw": "kW", "_ns": "ns"}
_TYPES: Final = {
    "int": "integer",
    "float": "float 64",
    "str": "string",
    "bool": "boolean",
}


def wire_document() -> str:
    """Return the document as Markdown."""
    return "\n".join([*_opening(), *_signal_table(), *_types(), *_layout(), *_cycle(), *_closing()])


def _opening() -> Iterator[str]:
    yield from _paragraphs(
        """
# On the wire

What a program in any language must do to take the place of one agent: a direct controller on a
microcontroller, a foreign plant, a real inverter's gateway. Written from the code by `python -m
launch_scripts.wire_document`; where the two differ, a test fails.

## Joining

The transport is [Zenoh](https://zenoh.io) 1.x in peer mode over TCP, without multicast and
without gossip: each pair of agents that talk has one link. The run's `plan.json` has all that is
to be known: `run_id` is the Zenoh *namespace* of every session, `plant` is the first part of
every key, `tcp_ports` are the ports on 127.0.0.1 on which some agents listen. An agent listens if
`tcp_ports` has its name, and connects to every listening agent that it exchanges messages with,
and to `recorder`. A direct controller never listens; it connects to its supervisor, to `plant`
and to `recorder`.

Each agent declares a liveliness token on `<plant>/<name>/alive`. Names are `plant`, `central`,
`recorder` and the paths of the control tree's other nodes, for instance `c1` and `c1/inv07`.

A payload is one msgpack map from field name to value, its encoding `application/msgpack`. A
reader must accept the fields in any order, integers in any of msgpack's widths, and must not
accept a field that it does not know. Publish reliably; in lockstep with congestion control BLOCK.
"""
    )


def _signal_table() -> Iterator[str]:
    yield "## Signals"
    yield ""
    yield "| key | type | about | published by | heard by | how often | recorded |"
    yield "|---|---|---|---|---|---|---|"
    for signal in SIGNALS:
        node = "" if signal.nodes(_TREE) == (ROOT,) else "<path>/"
        heard = ", ".join(role.value for role in signal.listeners) or "the recorder alone"
        yield (
            f"| `<plant>/{node}{signal.name}` | {signal.type.__name__} | {signal.about.value} "
            f"| {signal.publisher.value} | {heard} | {signal.occurrence.value} "
            f"| {'yes' if signal.logged else 'no'} |"
        )
    yield ""
    yield "*The node itself* is the one whose path stands in the key; the central controller's path"
    yield "is empty, so that its `impp` has the key `<plant>/impp`. The recorder hears everything."
    yield ""


def _types() -> Iterator[str]:
    yield "## Types"
    yield ""
    yield "Every message begins with these fields:"
    yield ""
    meanings = _attributes(Message)
    yield "| field | msgpack type | what it is |"
    yield "|---|---|---|"
    for field in fields(Message):
        yield f"| `{field.name}` | {_type_name(field.type)} | {meanings[field.name]} |"
    yield ""
    for signal in SIGNALS:
        yield f"### {signal.type.__name__}"
        yield ""
        yield from _doc(signal.type)
        own = [
            field for field in fields(signal.type) if field.name not in Message.__struct_fields__
        ]
        if own:
            yield from _field_table(signal.type)


def _field_table(kind: type[Message]) -> Iterator[str]:
    head = () if kind is Message else Message.__struct_fields__
    yield "| field | msgpack type | unit |"
    yield "|---|---|---|"
    for field in fields(kind):
        if field.name in head:
            continue
        unit = next((unit for end, unit in _UNITS.items() if field.name.endswith(end)), "")
        yield f"| `{field.name}` | {_type_name(field.type)} | {unit} |"
    yield ""


def _type_name(kind: object) -> str:
    text = inspect.formatannotation(kind).replace("bus_schemas.messages.", "")
    if "Literal" in text:
        return "string, one of " + text[text.index("[") + 1 : -1].replace("'", "")
    if "HelpGiven" in text:
        return "array of arrays [needy: string, power_kw: float 64]"
    if "tuple" in text:
        inner = text[text.index("[") + 1 : text.index(",")]
        return f"array of {_TYPES[inner]}"
    return next(name for word, name in _TYPES.items() if word in text)


def _doc(kind: type[Message]) -> Iterator[str]:
    yield inspect.cleandoc(kind.__doc__ or "")
    yield ""


def _attributes(kind: type[Message]) -> dict[str, str]:
    """Return what a numpydoc docstring says of each attribute, on one line each."""
    found: dict[str, str] = {}
    name = ""
    for line in inspect.cleandoc(kind.__doc__ or "").partition("----------\n")[2].splitlines():
        if line.startswith(" "):
            found[name] = f"{found[name]} {line.strip()}".strip()
        else:
            name = line
            found[name] = ""
    return found


def _layout() -> Iterator[str]:
    yield "## Byte by byte"
    yield ""
    yield "Telemetry of `c1/inv07` in cycle 2, after 120.5 kW at alpha 0.5:"
    yield ""
    telemetry = Telemetry(
        2, 1_270_159_202_000_000_000, PLANT, (), 5_000_000_000, 2,
        power_kw=120.5, alpha=0.5, limit_kw=470.0,
    )  # fmt: skip
    yield from _bytes_table(telemetry)
    yield "And the command that answers a setpoint of 100 kW:"
    yield ""
    command = Command(
        2, 1_270_159_202_000_000_000, _INVERTER, (), 5_004_000_000, 2,
        alpha=100.0 / 241.0, power_kw=100.0,
    )  # fmt: skip
    yield from _bytes_table(command)


def _bytes_table(message: Message) -> Iterator[str]:
    yield "| bytes (hex) | what they are |"
    yield "|---|---|"
    for part in _parts(encode(message)):
        yield f"| `{part.data.hex(' ')}` | {part.meaning} |"
    yield ""


@dataclass(frozen=True, slots=True)
class _Part:
    data: bytes
    meaning: str


def _parts(payload: bytes) -> Iterator[_Part]:
    """Take a flat msgpack map apart: its head, then each key and each value."""
    count = payload[0] & 0x0F
    yield _Part(payload[:1], f"a map of {count} entries")
    place = 1
    for _ in range(2 * count):
        part = _value(payload, place)
        yield part
        place += len(part.data)
    if place != len(payload):
        raise ValueError(f"{len(payload) - place} bytes are left over")


_FIXED: Final = {
    0xCB: (8, ">d", "float 64"),
    0xCC: (1, ">B", "unsigned integer of 1 byte"),
    0xCD: (2, ">H", "unsigned integer of 2 bytes"),
    0xCE: (4, ">I", "unsigned integer of 4 bytes"),
    0xCF: (8, ">Q", "unsigned integer of 8 bytes"),
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
    if first == 0x90:
        return _Part(payload[place : place + 1], "an array of 0 entries")
    raise ValueError(f"no example has the msgpack type {first:#x}")


def _cycle() -> Iterator[str]:
    yield from _paragraphs(
        """
## Within a cycle

An agent goes through its stages in their order. A stage closes when all messages of this cycle
that it awaits have come, or at its deadline; then the agent publishes what the stage yields.
Between the turns of a parent (`period_cycles` in the plan) its children do without its request
and setpoint.
"""
    )
    yield "| agent | stage | awaits | and, where announced | deadline, share of the cycle |"
    yield "|---|---|---|---|---|"
    family = Family("c1", ("c1/inv01", _INVERTER), (470.0, 470.0), (), 0)
    periods = Periods((1, 1))
    agents = (
        (
            "direct controller",
            DirectController(_INVERTER, 470.0, 0.05, periods, "paper", "fraction"),
        ),
        ("supervisor", Supervisor(family, periods)),
        (
            "central controller",
            CentralController(Family(ROOT, ("c1", "c2"), (1.0, 1.0), (), 0), periods),
        ),
    )
    for kind, agent in agents:
        for stage in agent.stages(0):
            name = CENTRAL if kind == "central controller" else agent.name
            awaits = ", ".join(sorted({port.signal.name for port in stage.awaits}))
            announced = ", ".join(sorted({port.signal.name for port in stage.on_need}))
            share = USED_SHARE * stage_place(name, stage.name, _TREE)
            share /= stage_place(PLANT, "advance", _TREE)
            yield f"| {kind} | {stage.name} | {awaits} | {announced} | {share:.3f} |"
    yield ""
    yield from _paragraphs(
        """
A negative `residual` announces a `help` of the same node and cycle: the parent waits for it. The
deadlines are those of three tiers; they count in real time only (`cycle_wall_ns` above 0 in the
plan), from the beginning of the cycle on the host's monotonic clock. In lockstep there is none.
"""
    )


def _closing() -> Iterator[str]:
    yield from _paragraphs(
        """
## Before cycle 0

Cycles with numbers below 0 are *arming rounds*: whole cycles that prove all links. Answer every
message of one as in the run, with the cycle number of the message, beginning each round from your
initial state; a message of a later round ends the round under way. Their messages have `sequence`
0. Cycle 0 begins with its first message, or with `run` of state `start`; `run` of state `stop`
names the first cycle that does not take place.

## Rules

- `source` is the agent's own name, and only the one that the table of signals names may publish
  on a key. Anything else is dropped, counted and named in the log.
- `cycle` and `sim_time_ns` are those of the messages that the stage used. `missing` lists the
  keys, without the plant's name, of the inputs of this cycle that did not come in time.
- `publish_time_ns` is the host's monotonic clock when the message goes out. `sequence` counts the
  messages on the key from 0, from cycle 0 on.
- Powers are in kW. A direct controller's `impp` lies between 0 and the rating, its `residual` is
  IMPP less request, `alpha` lies in (0, 1]. What does not, counts as silence.
"""
    )


def _paragraphs(text: str) -> Iterator[str]:
    yield text.strip("\n")
    yield ""


def main() -> None:
    """Write the document to standard output."""
    sys.stdout.write(wire_document())


if __name__ == "__main__":
    main()
