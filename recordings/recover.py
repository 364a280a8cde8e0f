"""Makes a whole recording of a cut or damaged one: everything in it that can be read."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from bus_schemas.messages import Message
from bus_schemas.signals import PRODUCTION, Port
from bus_schemas.tree import ROOT
from bus_schemas.whole_file import new_path
from recordings.read.gaps import gaps_of_ports
from recordings.read.reader import RunReader
from recordings.read.run_file import recorded_ports
from recordings.record.chunk_writer import ChunkWriter
from recordings.record.writer import declare

RECOVERY_METADATA: Final = "recovery"
"""Name of the metadata of a recovered file."""


class Recovery(msgspec.Struct, kw_only=True):
    """The result of a recovery.

    `closed`: the recorder had come to its end. `cut_bytes` at the end of the file make up no whole
    record. `lost` messages are missing between others. `damage` names damaged parts of the file.
    """

    source: str
    out: str
    closed: bool
    messages: int = 0
    complete_cycles: int = 0
    last_cycle: int
    planned_cycles: int
    cut_bytes: int
    lost: int = 0
    damage: str = ""

    @property
    def lossless(self) -> bool:
        """Whether nothing that was recorded can be missing."""
        return self.closed and not self.lost and not self.damage


def is_sound(run: RunReader) -> bool:
    """Whether a recording was closed in order and all of it can be read."""
    run.check_chunks()
    return run.whole and not run.damage_text()


def recover_run(run: RunReader, out: Path) -> Recovery:
    """Copy all of a recording that can be read into a new one.

    Attachments, metadata, schemas and channels are the same; so are the messages, byte for byte,
    with their times, sequence numbers and order. Metadata named `recovery` is added.
    """
    outline, gaps = run.outline, gaps_of_ports(run.plan)
    recovery = Recovery(
        source=str(run.path),
        out=str(out),
        closed=outline.closed,
        last_cycle=run.last_cycle,
        planned_cycles=run.plan.timing.cycles,
        cut_bytes=0 if outline.closed else max(outline.size - outline.readable_end, 0),
    )
    with new_path(out) as beside, beside.open("xb") as file:
        writer, channel_of = _begin(file, run)
        for chunk in run.followed_chunks():
            for raw in run.messages_of(chunk, run.channels):
                number, sequence, logged_ns, published_ns, payload = raw
                port = run.channels[number]
                writer.add_message(channel_of[port], logged_ns, payload, published_ns, sequence)
                recovery.messages += 1
                if (head := run.head(raw)) is not None:
                    gaps[port].see(head.cycle, sequence, head.incarnation)
        recovery.complete_cycles = gaps[PRODUCTION.of(ROOT)].cycles
        recovery.lost = sum(one.lost for one in gaps.values())
        recovery.damage = run.damage_text()
        metadata = {
            "recovered_from": run.path.name,
            "lossless": str(recovery.lossless).lower(),
            "cut_bytes": str(recovery.cut_bytes),
            "damage": recovery.damage,  # In the new file the checksums of attachments are right.
        }
        writer.add_metadata(RECOVERY_METADATA, metadata)
        writer.finish()
    return recovery


def _begin(file: BinaryIO, run: RunReader) -> tuple[ChunkWriter, dict[Port[Message], int]]:
    """Write all but the messages; return the writer, and the channel of each port."""
    outline, header = run.outline, run.outline.header
    writer = ChunkWriter(file, header.profile if header else "", header.library if header else "")
    for entry in outline.attachments:
        writer.add_attachment(
            entry.create_time, entry.log_time, entry.name, entry.media_type, entry.data
        )
    for name, entries in outline.metadata.items():
        writer.add_metadata(name, entries)
    return writer, declare(writer, run.plan, recorded_ports(run.plan))
