"""What a recording is: its names, version, scenario and plan."""

from __future__ import annotations

import glob
import re
from pathlib import Path
from typing import Final

import msgspec

from agents.plan import RunPlan
from agents.plan_file import check_plan
from bus_schemas.codec import UNREADABLE
from bus_schemas.errors import FailureError, InputError
from bus_schemas.messages import Message
from bus_schemas.signals import Occurrence, Port, ports
from bus_schemas.tree import PLANT, ROOT, agent_name
from recordings.read.mcap_file import Outline

RECORDING_NAME: Final = "run.mcap"
SUMMARY_NAME: Final = "summary.json"
FAILURE_NAME: Final = "failure.txt"

RECOVERY_METADATA: Final = "recovery"
"""Name of the metadata of a recording that was made from a cut or damaged one."""


def further_file(recording: Path, number: int) -> Path:
    """Return the file in which a recording goes on, from number 2 on."""
    return recording.with_stem(f"{recording.stem}-{number}")


def further_files(recording: Path) -> list[tuple[int, Path]]:
    """Return the further files that are there, with their numbers, in order."""
    found = recording.parent.glob(f"{glob.escape(recording.stem)}-*{recording.suffix}")
    texts = (path.stem.removeprefix(f"{recording.stem}-") for path in found)
    # Another name, as run-02.mcap, is none that a recorder gives.
    numbers = sorted(int(text) for text in texts if re.fullmatch("[1-9][0-9]*", text))
    return [(number, further_file(recording, number)) for number in numbers]


def next_path(recording: Path) -> Path:
    """Return the file to write next. Earlier ones may have been deleted."""
    if further := further_files(recording):
        return further_file(recording, further[-1][0] + 1)
    return further_file(recording, 2) if recording.exists() else recording


SCHEMA_VERSION: Final = "4"
"""Version of the message types. A reader refuses other versions."""


def log_name(agent: str) -> str:
    return f"{agent.replace('/', '.')}.log"


_MOST_CHANNELS: Final = 65_535
"""MCAP has no higher number for one."""


def recorded_ports(plan: RunPlan) -> tuple[Port[Message], ...]:
    """Return the ports that a recording has channels for, numbered from 1 in this order.

    A plant with too many has none for what single agents never say.
    """
    found = [port for port in ports(plan.tree) if port.signal.logged]
    if len(found) > _MOST_CHANNELS:
        speakers = {agent_name(ROOT), PLANT}
        found = [
            port
            for port in found
            if port.signal.occurrence is not Occurrence.EVENT or port.publisher in speakers
        ]
    if len(found) > _MOST_CHANNELS:
        expected = f"up to {_MOST_CHANNELS:,} keys in a recording"
        raise FailureError(
            f"expected {expected}, got {len(found):,}: take fewer inverters or tiers"
        )
    return tuple(found)


class NothingRecordedError(InputError):
    """A recording that was cut before the plan of its run."""


def read_origin(outline: Outline, path: Path) -> tuple[str, RunPlan]:
    _check_version(outline, path)
    attachments = {entry.name: entry.data for entry in outline.attachments}
    document = attachments.get("plan.json")
    if document is None or "plan.json" in outline.damaged_attachments:
        raise InputError(
            f"{path}: its attachment plan.json is {'missing' if document is None else 'damaged'}; "
            "nothing can be read without it"
        )
    try:
        plan = msgspec.json.decode(document, type=RunPlan)
        check_plan(plan)
    except (InputError, *UNREADABLE) as error:
        raise InputError(f"{path}: plan.json: {error}") from None
    # The scenario may be damaged: nothing depends on it, since the plan describes the run.
    return attachments.get("scenario.toml", b"").decode(errors="replace"), plan


def _check_version(outline: Outline, path: Path) -> None:
    version = outline.metadata.get("run", {}).get("schema_version")
    if version is None and outline.cut_early:
        raise NothingRecordedError(f"{path}: cut before the plan of its run")
    if version is None:
        raise InputError(f"{path}: an MCAP file, but no recording of a heliarch run")
    if version != SCHEMA_VERSION:
        raise InputError(
            f"{path}: recorded with schema version {version}, this Heliarch reads version "
            f"{SCHEMA_VERSION}; read it with the Heliarch that wrote it"
        )
