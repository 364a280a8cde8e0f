"""Streams a run to Foxglove and Lichtblick: its messages as JSON, on the topics of an export."""

from __future__ import annotations

import asyncio
import json
from typing import Final

from foxglove import Channel, Context, Schema, start_server
from foxglove.websocket import Capability

from agents.plan import RunPlan, load_plan
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port
from live_page.nodes import NodeStates
from live_page.run_view import RunView
from recordings.export.json_messages import json_bytes, object_schema

_SPEED: Final = 10.0
"""Of a recording that is complete, in simulated seconds a second."""

_MOST_CYCLES: Final = 5
"""Cycles at most that are sent at once; in lockstep others are left out."""

_IDLE_S: Final = 0.2
_TIME_FIRST_S: Final = 0.005
"""Times have a queue of their own, and Lichtblick dates messages by the newest one."""


class FoxgloveStream:
    """A server on the loopback address that viewers connect to. It can be asked, not commanded.

    Viewers see the simulated time of the plant. Nothing is read while they ask for no topic.
    """

    def __init__(self, view: RunView, port: int) -> None:
        self._view = view
        self._context = Context()
        states = view.open()
        if states is None:  # The run has not begun.
            plan = load_plan(view.path.with_name("plan.json"))
        else:
            plan = states.follower.plan
        # Before the server: a channel that comes later may be asked for before the server knows it.
        rows = [row for row in plan.wiring.ports if row.signal.logged and row.signal is not RUN]
        self._channels = {row: _channel(plan, row, self._context) for row in rows}
        try:
            self._server = start_server(
                name="Heliarch", port=port, capabilities=[Capability.Time], context=self._context
            )
        except (OSError, RuntimeError) as error:
            raise InputError(
                f"--foxglove: expected a free port on 127.0.0.1, got {port}: {error}"
            ) from None

    async def serve(self) -> None:
        """Follow the run while it goes on, or play its recording, whenever a viewer is there."""
        while True:
            states = self._view.open()
            if states is not None and self._wanted():
                await self._play(states)
            await asyncio.sleep(_IDLE_S)

    async def _play(self, states: NodeStates) -> None:
        states.follower.advance(0.0)
        goes_on = states.follower.state in {"waiting", "running"}
        sent = -1
        async for newest in self._view.cycles(None if goes_on else 0.0, _SPEED):
            wanted = self._wanted()
            if not wanted:
                return
            if newest is None:
                continue
            for cycle in range(max(sent, newest - _MOST_CYCLES) + 1, newest + 1):
                await self._send(states.messages(cycle, wanted))
            sent = newest

    def _wanted(self) -> set[Port[Message]]:
        return {port for port, channel in self._channels.items() if channel.has_sinks()}

    async def _send(self, messages: dict[Port[Message], Message]) -> None:
        if not messages:
            return
        time_ns = max(message.sim_time_ns for message in messages.values())
        self._server.broadcast_time(time_ns)
        await asyncio.sleep(_TIME_FIRST_S)
        for port, message in messages.items():
            self._channels[port].log(json_bytes(message), log_time=time_ns)


def _channel(plan: RunPlan, port: Port[Message], context: Context) -> Channel:
    return Channel(
        plan.wiring.key(port),
        message_encoding="json",
        schema=Schema(
            name=port.signal.type.__name__,
            encoding="jsonschema",
            data=json.dumps(object_schema(port.signal)).encode(),
        ),
        context=context,
    )
