"""What a run may take of the machine: from a scenario or the command line to checked settings."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import Annotated, cast

import msgspec
from msgspec import Meta

from agents.cycle import KINDS, Kind
from agents.machine import HIGHEST_PRIORITY, LOWEST_PRIORITY, MachineSettings
from bus_schemas.errors import InputError


class MachineTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the processes of a run may take of the machine.

    cpus: Processors of all processes, `"0-1"`, or of one kind, `"plant=0"`.
    priority: SCHED_FIFO priority; 0: normal policy.
    """

    cpus: tuple[str, ...] = ()
    priority: Annotated[int, Meta(ge=0, le=HIGHEST_PRIORITY)] = 0


def machine_settings(
    table: MachineTable, cpus: Sequence[str], priority: int | None, *, lockstep: bool
) -> MachineSettings:
    """Return what the processes of a run may take, by the scenario and the command line."""
    where, entries = ("--cpus", cpus) if cpus else ("machine.cpus:", table.cpus)
    of_kind: dict[str, tuple[int, ...]] = {}
    for entry in entries:
        kind, equals, listed = entry.rpartition("=")
        if equals and kind not in KINDS:
            raise InputError(
                f"{where} {entry}: expected a kind of process ({', '.join(KINDS)}), got {kind!r}"
            )
        of_kind[kind] = _cpu_list(f"{where} {entry}", listed)
    if priority is None:
        priority = table.priority
    elif not LOWEST_PRIORITY <= priority <= HIGHEST_PRIORITY:
        raise InputError(
            f"--priority: expected {LOWEST_PRIORITY} to {HIGHEST_PRIORITY}, got {priority}"
        )
    elif lockstep:
        raise InputError(
            "--priority: expected a --pace such as 1 with it, got lockstep, where nothing can be "
            "late"
        )
    everywhere = of_kind.pop("", ())
    kinds = cast("dict[Kind, tuple[int, ...]]", of_kind)
    return MachineSettings(everywhere, kinds, priority)


def _cpu_list(where: str, text: str) -> tuple[int, ...]:
    """Read a list of processors as the kernel writes it: `0`, `0-3` or `0,2-3`."""
    if not re.fullmatch(r"\d{1,4}(-\d{1,4})?(,\d{1,4}(-\d{1,4})?)*", text):
        raise InputError(f"{where}: expected processors such as 0, 0-3 or plant=0, got {text!r}")
    cpus: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("-")
        cpus.update(range(int(first), int(last or first) + 1))
    known = os.sched_getaffinity(0)
    if not cpus or not cpus <= known:
        listed = ", ".join(map(str, sorted(known)))
        raise InputError(f"{where}: expected processors of this machine, {listed}, got {text}")
    return tuple(sorted(cpus))
