"""What a recording is: its names, version, scenario and plan."""

from __future__ import annotations

from pathlib import Path
from typing import Final
from zoneinfo import ZoneInfo

import msgspec

from agents.plan import RunPlan, check_plan
from bus_schemas.errors import InputError
from bus_schemas.times import FIRST_YEAR, LAST_YEAR
from recordings.read.outline import Outline
from recordings.read.run_clock import RunClock

RECORDING_NAME: Final = "run.mcap"


def further_file(recording: Path, number: int) -> Path:
    """Return the file in which a recording goes on, the second or a later one of its recorders."""
    return recording.with_stem(f"{recording.stem}-{number}")


SCHEMA_VERSION: Final = "3"
"""Version of the message types. A reader refuses what it does not know."""


def log_name(agent: str) -> str:
    return f"{agent.replace('/', '.')}.log"


class NothingRecordedError(InputError):
    """A recording that was cut before the plan of its run."""


def read_origin(outline: Outline, path: Path) -> tuple[str, RunPlan]:
    """Return the scenario and the plan of the recording at a path."""
    _check_version(outline, path)
    attachments = {entry.name: entry.data for entry in outline.attachments}
    found = attachments.get("plan.json")
    if found is None or "plan.json" in outline.damaged_attachments:
        raise InputError(
            f"{path}: its attachment plan.json is {'missing' if found is None else 'damaged'}; "
            "nothing can be read without it"
        )
    try:
        plan = msgspec.json.decode(found, type=RunPlan)
        check_plan(plan)
        _check_times(plan)
    except (InputError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: plan.json: {error}") from None
    # The scenario may be damaged: nothing depends on it, since the plan describes the run.
    return attachments.get("scenario.toml", b"").decode(errors="replace"), plan


def _check_version(outline: Outline, path: Path) -> None:
    found = outline.metadata.get("run", {}).get("schema_version")
    if found is None and outline.cut_early:
        raise NothingRecordedError(f"{path}: cut before the plan of its run")
    if found is None:
        raise InputError(f"{path}: an MCAP file, but no recording of a heliarch run")
    if found != SCHEMA_VERSION:
        raise InputError(
            f"{path}: recorded with schema version {found}, this Heliarch reads version "
            f"{SCHEMA_VERSION}; read it with the Heliarch that wrote it"
        )


def _check_times(plan: RunPlan) -> None:
    """Refuse a plan whose cycles have no time."""
    try:
        ZoneInfo(plan.timezone)
    except (KeyError, ValueError, OSError):
        raise InputError(
            f"timezone: expected a name such as Pacific/Honolulu, got {plan.timezone[:40]!r}"
        ) from None
    years = [RunClock(plan, 0).local(cycle).year for cycle in (0, plan.cycles)]
    if years[0] < FIRST_YEAR or years[1] > LAST_YEAR:
        raise InputError(
            f"start_time_ns: expected a run in the years {FIRST_YEAR} to {LAST_YEAR}, got "
            f"{years[0]} to {years[1]}"
        )
