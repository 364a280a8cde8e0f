"""`heliarch recover`: a whole recording out of one that was cut."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from launch_scripts.commands.boundary import FAILED, OK, complain
from launch_scripts.commands.output import progress_bar, say, write_json
from studies.tables import console_for

if TYPE_CHECKING:
    from recordings.recover import Recovery

LOSSY: Final = 3


def recover(
    run: Path,
    out: Path | None = None,
    json: str | None = None,
) -> int:
    """Repair a recording that a crash or a full disk cut short.

    Exit status: 0 if nothing is missing, 3 if something is or may be,
    1 if no message can be read.

    --out FILE: The new file; default run.recovered.mcap beside the recording.
    Example: heliarch recover runs/oahu-20261121-120000-4711 --out whole.mcap
    """
    import msgspec

    from recordings.read.reader import RunReader
    from recordings.read.run_file import NothingRecordedError
    from recordings.recover import is_sound, recover_run

    console = console_for(json)
    try:
        reader = RunReader(run, skip_damaged=True)
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
        say(console, *_lines(recovery))
    write_json(msgspec.to_builtins(recovery) | {"lossless": recovery.lossless}, json)
    return OK if recovery.lossless else LOSSY


def _lines(recovery: Recovery) -> Iterator[str]:
    """Say what there is and what is missing."""
    from recordings.record.recorder import FLUSH_S

    yield f"recovered: {recovery.out}"
    yield (
        f"kept: {recovery.messages:,} messages, {recovery.complete_cycles:,} complete cycles of "
        f"{recovery.planned_cycles:,} planned, up to cycle {recovery.last_cycle:,}"
    )
    if recovery.damage:
        yield recovery.damage
    if recovery.cut_bytes:
        yield f"missing: the last {recovery.cut_bytes:,} bytes, which are an incomplete record"
    if recovery.lost:
        yield f"may be missing: {recovery.lost:,} messages, by the gaps in the sequence numbers"
    if recovery.lossless:
        yield "missing: nothing"
    elif not recovery.closed:
        yield f"missing: what came last; if the recorder was killed, at most {FLUSH_S:g} s"
