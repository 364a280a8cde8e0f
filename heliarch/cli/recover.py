"""`heliarch recover`: a whole recording out of one that was cut."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import msgspec
from cyclopts import Parameter

from bus_schemas.errors import FailureError
from heliarch.cli.boundary import OK
from heliarch.cli.options import FILES, Json, Run
from heliarch.cli.output import Output, progress_bar

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

    output = Output(json)
    try:
        reader = RunReader(run)
    except NothingRecordedError as error:
        raise FailureError(f"{error}: there is nothing to recover") from None
    with reader:
        with progress_bar("checking") as reader.follow:
            sound = is_sound(reader)
        if sound:
            output.say(f"{reader.path}: it is whole, there is nothing to recover")
            output.write({"source": str(reader.path), "out": None, "lossless": True})
            return OK
        out = out or reader.path.with_suffix(".recovered.mcap")
        with progress_bar("copying") as reader.follow:
            found = recover_run(reader, out)
        if not found.messages:
            out.unlink()
            raise FailureError(
                f"{reader.path}: no message can be read, there is nothing to recover"
            )
    output.say(
        f"recovered: {found.out}",
        f"kept: {found.messages:,} messages, {found.complete_cycles:,} complete cycles of "
        f"{found.planned_cycles:,} planned, up to cycle {found.last_cycle:,}",
    )
    if found.cut_bytes:
        output.say(f"missing: the last {found.cut_bytes:,} bytes, which are an incomplete record")
    if found.lost:
        output.say(f"may be missing: {found.lost:,} messages, by the gaps in the sequence numbers")
    if found.lossless:
        output.say("missing: nothing")
    elif not found.closed:
        output.say(f"missing: what came last; if the recorder was killed, at most {FLUSH_S:g} s")
    output.write(msgspec.to_builtins(found) | {"lossless": found.lossless})
    return OK if found.lossless else LOSSY
