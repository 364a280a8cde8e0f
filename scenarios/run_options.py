"""Options of a run: which part of a scenario runs, what differs from the scenario, and how."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import get_args

from agents.process.machine import HIGHEST_PRIORITY, LOWEST_PRIORITY
from agents.settings import Actuator, Scheme
from bus_schemas.errors import InputError, not_one_of
from scenarios.elsewhere import own_address, split_devices
from scenarios.fault_rules import parse_fault
from scenarios.real_time import cpus_by_kind, parse_pace
from scenarios.times import parse_duration_s, parse_time

LARGEST_SEED = 2**32
LONGEST_WAIT_S = 86_400.0


@dataclass(frozen=True)
class RunOptions:
    """What is asked for, beside a scenario, of any run. None: as in the scenario.

    `heliarch/cli/options.py` has the texts of the options with these names. `timing` sets its own
    length of the cycle.
    """

    start: str | None = None
    duration: str | None = None
    end: str | None = None
    seed: int | None = None
    scheme: Scheme | None = None
    actuator: Actuator | None = None
    faults: list[str] | None = None
    pace: str | float | None = None
    cycle_s: float | None = None
    _: KW_ONLY
    external: list[str] | None = None
    devices: list[str] | None = None
    external_timeout_s: float = 60.0
    base_port: int | None = None
    secure: bool | None = None
    keys: Path | None = None
    address: str = "127.0.0.1"
    on: list[str] | None = None
    cpus: list[str] | None = None
    priority: int | None = None


def check_options(options: RunOptions) -> None:
    """Check options as far as they go without a scenario; this imports nothing that is slow."""
    for name, value, known in (
        ("--scheme", options.scheme, get_args(Scheme)),
        ("--actuator", options.actuator, get_args(Actuator)),
    ):
        if value is not None and value not in known:
            raise InputError(f"{name}: {not_one_of(known, value)}")
    for name, number, least, most in (
        ("--seed", options.seed, 0, LARGEST_SEED),
        ("--priority", options.priority, LOWEST_PRIORITY, HIGHEST_PRIORITY),
        ("--external-timeout", options.external_timeout_s, 0.001, LONGEST_WAIT_S),
    ):
        if number is not None and not least <= number <= most:
            raise InputError(f"{name}: expected {least} to {most:.10g}, got {number:.10g}")
    for name, moment in (("--from", options.start), ("--to", options.end)):
        if moment is not None:
            parse_time(moment, name)
    if options.duration is not None:
        if options.end is not None:
            raise InputError("--to: expected no --duration with it")
        parse_duration_s(options.duration, "--duration")
    for text in options.faults or ():
        parse_fault(text)
    parse_pace(options.pace)
    split_devices(options.devices or ())
    own_address(options.address)
    cpus_by_kind("--cpus", options.cpus or ())
