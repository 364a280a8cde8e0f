"""What a recording looks like: its name, its version, its schemas and channels."""

from __future__ import annotations

import json
from typing import Final

from mcap.records import Channel, Schema

from agents.plan import RunPlan
from bus_schemas.codec import json_schema
from bus_schemas.signals import SIGNALS, ports
from recordings.read.outline import Outline

RECORDING_NAME: Final = "run.mcap"
SCHEMA_VERSION: Final = "3"
"""Version of the message types. A reader refuses what it does not know."""


def schemas() -> list[Schema]:
    """Return the schemas of every recording, numbered from 1 in the order of the table."""
    logged = (signal for signal in SIGNALS if signal.logged)
    return [
        Schema(
            id=number,
            name=signal.type.__name__,
            encoding="jsonschema",
            data=json.dumps(json_schema(signal)).encode(),
        )
        for number, signal in enumerate(logged, start=1)
    ]


def channels(plan: RunPlan) -> list[Channel]:
    """Return the channels of a run's recording, numbered from 1 in the order of its ports."""
    schema_of = {
        signal: number
        for number, signal in enumerate((row for row in SIGNALS if row.logged), start=1)
    }
    logged = (port for port in ports(plan.tree) if port.signal.logged)
    return [
        Channel(
            id=number,
            topic=plan.keys.key(port),
            message_encoding="msgpack",
            schema_id=schema_of[port.signal],
            metadata={"signal": port.signal.name, "node": port.node},
        )
        for number, port in enumerate(logged, start=1)
    ]


def declare(outline: Outline, plan: RunPlan) -> None:
    """Give the outline of a file the schemas and channels that its plan leads to."""
    outline.schemas = {schema.id: schema for schema in schemas()}
    outline.channels = {channel.id: channel for channel in channels(plan)}
