"""`heliarch recover`: a whole recording out of one that was cut."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import msgspec
from cyclopts import Parameter

from heliarch.cli.boundary import FAILED, OK, complain
from heliarch.cli.options import FILES, Json, Run
from heliarch.cli.output import progress_bar, say, write_json
from results.tables import console_for

LOSSY: Final = 3


def recover(
    run: Run,
    /,
    *,
    out: Annotated[Path | None, Parameter(metavar="FILE", group=FILES)] = None,
    json: Json = None,
) -> int:
    """Repair a recording that a crash or a full disk cut short.

    Exit status: 0 if nothing is missing, 3 if something is or may be, 1 if no message can be read.

    Example: `heliarch recover runs/oahu-20261121-120000-4711 --out whole.mcap`

    Parameters
    ----------
    out
        The new file; default run.recovered.mcap beside the recording.
    """
    from recordings.read.reader import RunReader
    from recordings.read.run_file import NothingRecordedError
    from recordings.record.recorder import FLUSH_S
    from recordings.recover import is_sound, recover_run

    console = console_for(json)
    try:
        reader = RunReader(run)
    except NothingRecordedError as error:
        return complain(f"{error}: there is nothing to recover", FAILED)
    with reader:
        with progress_bar("checking") as reader.follow:
            sound = is_sound(reader)
        if sound:
            say(console, f"{reader.path}: it is whole, there is nothing to recover")
            write_json({"source": str(reader.path), "out": None, "lossless": True}, json)
            return OK
        out = out or reader.path.with_suffix(".recovered.mcap")
        with progress_bar("copying") as reader.follow:
            recovery = recover_run(reader, out)
        if not recovery.messages:
            out.unlink()
            nothing = "no message can be read, there is nothing to recover"
            return complain(f"{reader.path}: {nothing}", FAILED)
    lines = [
        f"recovered: {recovery.out}",
        f"kept: {recovery.messages:,} messages, {recovery.complete_cycles:,} complete cycles of "
        f"{recovery.planned_cycles:,} planned, up to cycle {recovery.last_cycle:,}",
    ]
    if recovery.cut_bytes:
        what = "which are an incomplete record"
        lines.append(f"missing: the last {recovery.cut_bytes:,} bytes, {what}")
    if recovery.lost:
        why = "by the gaps in the sequence numbers"
        lines.append(f"may be missing: {recovery.lost:,} messages, {why}")
    if recovery.lossless:
        lines.append("missing: nothing")
    elif not recovery.closed:
        lost_s = f"if the recorder was killed, at most {FLUSH_S:g} s"
        lines.append(f"missing: what came last; {lost_s}")
    say(console, *lines)
    write_json(msgspec.to_builtins(recovery) | {"lossless": recovery.lossless}, json)
    return OK if recovery.lossless else LOSSY
