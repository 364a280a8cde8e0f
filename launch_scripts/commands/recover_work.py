"""`heliarch recover`: a whole recording out of one that was cut."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Final

import msgspec
from rich.console import Console

from bus_schemas.errors import InputError
from launch_scripts.commands.reading_progress import reading_progress
from launch_scripts.commands.termination import leaving_on_sigterm
from launch_scripts.exit_status import BAD_INPUT, INTERRUPTED, complain
from launch_scripts.launcher.json_rows import check_json_destination
from recordings.read.moments import RunClock
from recordings.read.reader import NothingRecordedError, RunReader
from recordings.record.recorder import FLUSH_S
from recordings.recover import Recovery, is_sound, recover_run

WHOLE: Final = 0
NOTHING: Final = 1
LOSSY: Final = 3

_WIDTH: Final = 100
_SUFFIX: Final = ".recovered.mcap"


def recover(path: Path, out: Path | None, json: str | None) -> int:
    """Recover a recording and say what is missing. Returns the exit status.

    Parameters
    ----------
    path
        Folder of the run, or its MCAP file.
    out
        The new file; by default `run.recovered.mcap` beside the recording.
    json
        Where the result goes as JSON: a path, `-` for standard output, or None.
    """
    console = Console(stderr=json == "-", soft_wrap=True, highlight=False, markup=False)
    try:
        check_json_destination(json)
        with RunReader(path) as run, leaving_on_sigterm():
            return _recover(run, out or run.path.with_suffix(_SUFFIX), json, console)
    except NothingRecordedError as error:
        return complain(f"{error}: there is nothing to recover", NOTHING)
    except InputError as error:
        return complain(error, BAD_INPUT)
    except OSError as error:
        return complain(f"{error.filename or out or path}: {error.strerror}", NOTHING)
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)


def _recover(run: RunReader, out: Path, json: str | None, console: Console) -> int:
    with reading_progress("checking") as follow:
        sound = is_sound(run, follow)
    if sound:
        console.print(f"{run.path}: it is whole, there is nothing to recover")
        document: dict[str, object] = {"source": str(run.path), "out": None, "lossless": True}
        return _write_json(document, json, WHOLE)
    with reading_progress("copying") as follow:
        recovery = recover_run(run, out, follow)
    if not recovery.messages:
        out.unlink()
        return complain(f"{run.path}: no message can be read, there is nothing to recover", NOTHING)
    for line in _account(run, recovery):
        console.print(textwrap.fill(line, _WIDTH, subsequent_indent="  ", break_long_words=False))
    document = msgspec.to_builtins(recovery) | {"lossless": recovery.lossless}
    return _write_json(document, json, WHOLE if recovery.lossless else LOSSY)


def _account(run: RunReader, recovery: Recovery) -> Iterator[str]:
    """Say what there is and what is missing."""
    yield f"recovered: {recovery.out}"
    clock = RunClock(run.plan, recovery.last_cycle)
    up_to = f" up to {clock.local(recovery.last_cycle):%Y-%m-%d %H:%M:%S}"
    yield (
        f"kept: {recovery.messages:,} messages, {recovery.complete_cycles:,} complete cycles"
        f"{up_to if recovery.last_cycle >= 0 else ''}, with plan, scenario, schemas, times and "
        "sequence numbers"
    )
    for chunk in recovery.damaged:
        yield (
            f"missing: a damaged chunk at byte {chunk.offset:,}, recorded from "
            f"{_wall_time(chunk.first_ns)} to {_wall_time(chunk.last_ns)}: {chunk.reason}"
        )
    if recovery.cut_bytes:
        yield (
            f"the last {recovery.cut_bytes:,} bytes are an incomplete record; "
            f"{recovery.cut_messages:,} messages could be read of it"
            f"{', they have no checksum and may be damaged' if recovery.cut_messages else ''}"
        )
    if recovery.damaged_attachments:
        yield f"damaged: attachment {', '.join(recovery.damaged_attachments)}, kept as it is"
    shortfall = recovery.shortfall
    if shortfall.lost:
        yield f"may be missing: {shortfall.lost:,} messages, their sequence numbers are left out"
    if shortfall.early_ports:
        yield (
            f"may be missing: the last messages of {shortfall.early_ports:,} keys, "
            f"{shortfall.early_messages:,} were due up to the end of the run"
        )
    if recovery.lossless:
        yield "missing: nothing, the recording goes up to the end of the run"
    elif not recovery.closed:
        yield (
            f"missing: what came after {_wall_time(recovery.last_ns)}, wall clock; of what the "
            f"recorder had heard, that is the last {FLUSH_S:g} s if it was killed"
        )
    if not recovery.ended:
        yield (
            f"the run was planned for {recovery.planned_cycles:,} cycles; nothing tells of those "
            f"after cycle {recovery.last_cycle:,}"
        )


def _wall_time(time_ns: int) -> str:
    """Return the wall clock of this machine's time zone."""
    try:
        return f"{datetime.fromtimestamp(time_ns / 1e9).astimezone():%Y-%m-%d %H:%M:%S.%f %Z}"
    except (OverflowError, ValueError, OSError):
        return f"a time that is damaged ({time_ns:,} ns)"


def _write_json(document: dict[str, object], json: str | None, status: int) -> int:
    """Write the result; return the exit status, which is another if that fails."""
    text = msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n"
    try:
        if json == "-":
            sys.stdout.write(text.decode())
        elif json is not None:
            Path(json).write_bytes(text)
    except OSError as error:
        return complain(f"--json: {error}", NOTHING)
    return status
