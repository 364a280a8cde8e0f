"""Which agents are heard: by the recorder, and by the listeners, which say what is `missing`."""

from __future__ import annotations

from typing import Final

import msgspec

from agents.plan import RunPlan
from bus_schemas.messages import Head, parse_missing
from bus_schemas.tree import PLANT, agent_name
from recordings.read.gaps import NOTHING_MISSED
from recordings.record.phases import longest_pause_s

_LATE_CYCLES: Final = 2
"""A listener whose newest message of an agent is older than so many cycles does not hear it."""


class _Lacks(msgspec.Struct, gc=False):
    missing: tuple[str, ...] = ()


_decode_lacks = msgspec.msgpack.Decoder(_Lacks).decode


class Reach:
    """When each agent was last heard, and when a listener last lacked several messages of it."""

    def __init__(self, plan: RunPlan, now_ns: int) -> None:
        self._plan = plan
        self._heard_at_ns = dict.fromkeys((PLANT, *map(agent_name, plan.tree.nodes)), now_ns)
        self._lacked_at_ns: dict[str, int] = {}
        self._pause_ns = round(longest_pause_s(plan) * 1e9)

    def hear(self, head: Head, payload: bytes, now_ns: int) -> None:
        self._heard_at_ns[head.source] = now_ns
        if head.cycle < 0 or NOTHING_MISSED in payload:
            return
        if head.source in self._plan.access.external:
            return  # No session of ours is opened anew because a device says so.
        try:
            missing = _decode_lacks(payload).missing
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return  # Its body is not decoded here: readers skip and name it.
        for key, cycle in map(parse_missing, missing):
            port = self._plan.wiring.port(f"{self._plan.plant}/{key}")
            if port is None:
                continue
            is_late = cycle is not None and (
                head.cycle - cycle <= _LATE_CYCLES * self._plan.control.period(port)
            )
            if not is_late:
                self._lacked_at_ns[port.publisher] = now_ns

    def not_heard(self, now_ns: int) -> list[str]:
        """Return the agents that the recorder has not heard for a while."""
        return [name for name, at in self._heard_at_ns.items() if at < now_ns - self._pause_ns]

    def missed(self, now_ns: int) -> list[str]:
        """Return the agents that some listener does not hear."""
        return [name for name, at in self._lacked_at_ns.items() if at >= now_ns - self._pause_ns]
