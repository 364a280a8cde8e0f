"""Says in real time which device answers late or not at all: its listeners state what they lack."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from agents.plan import RunPlan
from bus_schemas.messages import Head, Message, parse_missing
from bus_schemas.signals import PRODUCTION, Port
from bus_schemas.tree import PLANT
from recordings.read.gaps import lacks

_QUIET_CYCLES: Final = 2
"""A device is in time again after this many cycles in which no listener lacked its messages."""


@dataclass
class _Device:
    """newest: Newest cycle on each of its keys. since, last: Cycles between which it was late."""

    newest: dict[str, int]
    since: int | None = None
    last: int = -1


class DeviceWatch:
    """The controllers of a run that are devices."""

    def __init__(self, plan: RunPlan) -> None:
        self._devices = {agent: _Device({}) for agent in plan.access.external if agent != PLANT}
        self._publisher = {
            str(port): port.publisher
            for port in plan.wiring.ports
            if port.publisher in self._devices
        }

    def hear(self, port: Port[Message], head: Head, payload: bytes) -> Iterator[str]:
        """Take in a message; yield a line if a device is late, or in time again."""
        if not self._devices:
            return
        if (device := self._devices.get(port.publisher)) is not None:
            device.newest[str(port)] = max(head.cycle, device.newest.get(str(port), -1))
        else:
            yield from self._lacked(head, lacks(payload))
        if port.signal is PRODUCTION:
            yield from self._recovered(head.cycle)

    def _lacked(self, head: Head, missing: tuple[str, ...]) -> Iterator[str]:
        for key, _ in map(parse_missing, missing):
            if (agent := self._publisher.get(key)) is None:
                continue
            device = self._devices[agent]
            device.last = max(device.last, head.cycle)
            if device.since is None:
                device.since = head.cycle
                newest = device.newest.get(key, -1)
                is_late = newest >= head.cycle
                how = "came late" if is_late else f"is missing, the newest is of cycle {newest:,}"
                yield f"{agent}: {key} of cycle {head.cycle:,} {how}"

    def _recovered(self, cycle: int) -> Iterator[str]:
        for agent, device in self._devices.items():
            if device.since is not None and cycle > device.last + _QUIET_CYCLES:
                span = f"cycles {device.since:,} to {device.last:,}"
                device.since = None
                yield f"{agent}: in time again; answers were late or missing in {span}"
