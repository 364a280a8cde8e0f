"""Options of a run, each stated once: for `heliarch --help`, for Python, and with its check.

The names in errors are those of the command line.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, Self, TypeAlias, get_args

from cyclopts import Group, Parameter, Token

from agents.process.machine import HIGHEST_PRIORITY, LOWEST_PRIORITY
from agents.settings import Actuator, Scheme
from bus_schemas.errors import InputError, not_one_of
from scenarios.elsewhere import read_address, split_devices
from scenarios.real_time import machine_settings, parse_pace
from scenarios.times import (
    SHORTEST_CYCLE_S,
    When,
    parse_duration_s,
    parse_moment,
    read_seconds,
)
from sunspec.addresses import parse_address

LARGEST_SEED = 2**32
LONGEST_WAIT_S = 86_400.0

PLANT = Group.create_ordered("Plant")
TIME = Group.create_ordered("Time")
FAULTS = Group.create_ordered("Faults")
DEVICES = Group.create_ordered("Your own devices")
HOSTS = Group.create_ordered("Other hosts and security")
MACHINE = Group.create_ordered("Processors")
RECORDING = Group.create_ordered("Recording")

_SIZES = {"kB": 1e3, "MB": 1e6, "GB": 1e9}


def _whole_number(kind: object, tokens: Sequence[Token]) -> int:
    """Read a whole number; by itself, cyclopts would round others."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"expected a whole number, got {tokens[0].value}") from None


Whole: TypeAlias = Annotated[int, Parameter(converter=_whole_number)]
Seed: TypeAlias = Annotated[
    Whole | None, Parameter("--seed", group=PLANT, help="Seed of the synthetic clouds.")
]
_Moment: TypeAlias = When | None
_Texts: TypeAlias = list[str] | None


@Parameter("*", group=TIME)
@dataclass(frozen=True)
class TimeOptions:
    """Which part of a scenario is run.

    Parameters
    ----------
    start
        Begin of the first cycle: local time (12:30, 2010-04-01T12:30), seconds (90, 15m, 1h30m) or
        cycles (c90) after the scenario's start.
    duration
        Simulated time, in place of --to: seconds (90, 15m, 1h30m), or cycles (c90).
    end
        End of the last cycle, in the forms of --from.
    """

    start: Annotated[_Moment, Parameter("--from", metavar="TIME")] = None
    duration: Annotated[_Moment, Parameter(metavar="TIME")] = None
    end: Annotated[_Moment, Parameter("--to", metavar="TIME")] = None

    def __post_init__(self) -> None:
        for name, moment in (("--from", self.start), ("--to", self.end)):
            if moment is not None:
                parse_moment(moment, name)
        if self.duration is not None:
            if self.end is not None:
                raise InputError.of(
                    "--to", "expected no second length of the run, --duration, with it"
                )
            parse_duration_s(self.duration, "--duration", SHORTEST_CYCLE_S)


@Parameter("*", group=TIME)
@dataclass(frozen=True)
class SpanOptions(TimeOptions):
    """Which part of a scenario is run, and how fast.

    Parameters
    ----------
    pace
        Simulated seconds per second: 1 is real time, max is lockstep.
    """

    pace: Annotated[str | float | None, Parameter(metavar="PACE")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        parse_pace(self.pace)


@Parameter("*", group=PLANT)
@dataclass(frozen=True)
class PlantOptions:
    """What is different from the scenario.

    Parameters
    ----------
    scheme
        How maximum powers are estimated.
    actuator
        Whether a command is a fraction of the maximum or a power limit.
    faults
        Make links imperfect: `source=c1/*,delay=50ms` (fields: source, listener, signal, delay,
        jitter, distribution, loss, duplicate, reorder, reorder-by, at=60..90). In `launch` faults
        need a --pace. Or cut links, freeze or kill controllers: `source=c1,blackout=5s..9s`,
        `partition=c1|c2,at=5s..9s`, `freeze=c2,at=5s..9s`, `kill=c2,at=5s`,
        `trip=c2/inv07,at=5s..9s`. May be given several times.
    """

    seed: Seed = None
    scheme: Scheme | None = None
    actuator: Actuator | None = None
    faults: Annotated[_Texts, Parameter("--fault", metavar="RULE", group=FAULTS)] = None

    def __post_init__(self) -> None:
        _check_range("--seed", self.seed, 0, LARGEST_SEED)
        check_names("--scheme", self.scheme, get_args(Scheme))
        check_names("--actuator", self.actuator, get_args(Actuator))


@Parameter("*")
@dataclass(frozen=True)
class ProcessOptions:
    """External agents, real devices, keys, and how the processes use the machine.

    Parameters
    ----------
    external
        Do not start this agent; wait for your own device: c2/inv07, c2, central or plant. May be
        given several times.
    devices
        Use a real inverter or storage, over Modbus TCP: NODE=modbus://10.0.0.7/1. With one for
        each of them, meter=ADDRESS is the plant's real meter. May be given several times.
    operator
        Take orders over Modbus TCP at this address: modbus://127.0.0.1:5030. The plant is one
        SunSpec unit there.
    external_timeout_s
        How long to wait for external agents and other hosts. Once all are there, they have 30 s
        to answer the arming rounds.
    base_port
        Listen on this port and those after it, with the plant's name as namespace, so that a
        device is configured once.
    secure
        Encrypt every link, and admit agents only by the certificates of `heliarch keys`.
    keys
        Folder of the keys; default keys/PLANT.
    address
        Address at which the agents listen, for devices and controllers on other hosts; needs
        --secure.
    on
        Leave these controllers to `heliarch node` on the host with this address:
        `10.0.0.2=c2/*,c3/inv12`. May be given several times.
    cpus
        Run the processes on these processors: 0-1, or plant=0 for one kind (recorder, plant,
        central, supervisor, direct). May be given several times.
    priority
        In real time: run plant and controllers, and what receives for the recorder, under
        SCHED_FIFO with this priority, 1 to 99, if the machine permits it.
    split
        Go on in a next file after this much time of the run, or at this size: 1h, 1GB.
    """

    external: Annotated[_Texts, Parameter(metavar="AGENT", group=DEVICES)] = None
    devices: Annotated[_Texts, Parameter("--device", metavar="NODE=ADDRESS", group=DEVICES)] = None
    operator: Annotated[str | None, Parameter(metavar="ADDRESS", group=DEVICES)] = None
    external_timeout_s: Annotated[
        float, Parameter("--external-timeout", metavar="SECONDS", group=DEVICES)
    ] = 60.0
    base_port: Annotated[Whole | None, Parameter(metavar="PORT", group=DEVICES)] = None
    secure: Annotated[bool, Parameter(group=HOSTS)] = False
    keys: Annotated[Path | None, Parameter(metavar="DIR", group=HOSTS)] = None
    address: Annotated[str, Parameter(metavar="ADDRESS", group=HOSTS)] = "127.0.0.1"
    on: Annotated[_Texts, Parameter(metavar="ADDRESS=AGENTS", group=HOSTS)] = None
    cpus: Annotated[_Texts, Parameter(metavar="CPUS", group=MACHINE)] = None
    priority: Annotated[Whole | None, Parameter(group=MACHINE)] = None
    split: Annotated[str | None, Parameter(metavar="TIME|SIZE", group=RECORDING)] = None

    def __post_init__(self) -> None:
        split_devices(self.devices or ())
        if self.operator is not None:
            parse_address(self.operator, "--operator")
        _check_range("--external-timeout", self.external_timeout_s, 0.001, LONGEST_WAIT_S)
        read_address(self.address)
        for text in self.on or ():
            read_address(text.partition("=")[0], f"--on {text}")
        machine_settings(self.cpus or ())
        _check_range("--priority", self.priority, LOWEST_PRIORITY, HIGHEST_PRIORITY)
        parse_split(self.split)


@dataclass(frozen=True)
class RunOptions(SpanOptions, PlantOptions, ProcessOptions):
    """All that can be asked for of a run, beside its scenario. None: as in the scenario.

    `timing` sets `cycle_s`, its own length of a cycle [s].
    """

    cycle_s: float | None = None

    def __post_init__(self) -> None:
        for group in (SpanOptions, PlantOptions, ProcessOptions):
            group.__post_init__(self)

    @classmethod
    def of(cls, *groups: object) -> Self:
        fields: dict[str, Any] = {}
        for group in groups:
            fields |= vars(group)
        return cls(**fields)


def parse_split(text: str | None) -> tuple[float, int]:
    """Return when a file of a recording is full: after seconds, at bytes; 0: never."""
    if text is None:
        return 0.0, 0
    number, unit = text[:-2], text[-2:]
    if unit in _SIZES and number.isascii() and number.isdigit() and int(number):
        return 0.0, round(int(number) * _SIZES[unit])
    if seconds := read_seconds(text):
        return seconds, 0
    raise InputError.of("--split", f"expected a time or a size such as 1h or 1GB, got {text[:40]}")


def check_names(where: str, names: str | Iterable[str] | None, known: Collection[str]) -> None:
    for name in [names] if isinstance(names, str) else names or ():
        if name not in known:
            raise InputError.of(where, not_one_of(known, name))


def _check_range(where: str, number: float | None, least: float, most: float) -> None:
    kind = Integral if isinstance(least, int) else Real
    if number is not None and not (isinstance(number, kind) and least <= number <= most):
        raise InputError.of(where, f"expected {least} to {most:.10g}, got {number}")
