"""Of a recording that was cut all that is there up to the cut is in the new one, bit for bit."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Message
from recordings_by_hand import whole_run, write_run

from bus_schemas.bus import Delivery
from recordings.read.reader import RunReader
from recordings.recover import RECOVERY_METADATA, Recovery, is_sound, recover_run

CYCLES = 100

Recording = tuple[Path, list[Delivery]]
"""A file, and what was written into it."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("recovery") / "run.mcap"
    return path, write_run(path, whole_run(CYCLES), messages_per_chunk=1000)


def recovered(content: bytes, folder: Path) -> tuple[Path, Recovery]:
    cut, out = folder / "run.mcap", folder / "new.mcap"
    cut.write_bytes(content)
    out.unlink(missing_ok=True)
    with RunReader(cut) as run:
        return out, recover_run(run, out)


def all_of(path: Path) -> tuple[list[object], list[Message]]:
    """Everything in a file as the library finds it, but for the word of its recovery."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        origin = [
            reader.get_header(),
            list(reader.iter_attachments()),
            [entry for entry in reader.iter_metadata() if entry.name != RECOVERY_METADATA],
            summary.schemas,
            summary.channels,
        ]
        messages = [message for _, _, message in reader.iter_messages(log_time_order=False)]
        return origin, messages


@pytest.mark.parametrize("closed", [True, False])
def test_a_file_that_lost_its_index_is_whole_again(
    recording: Recording, tmp_path: Path, closed: bool
) -> None:
    path, _ = recording
    with RunReader(path) as run:
        end = run.outline.readable_end
    out, recovery = recovered(path.read_bytes()[: end - 13 * (not closed)], tmp_path)
    assert all_of(out) == all_of(path)
    assert recovery.complete_cycles == CYCLES
    assert recovery.lossless == closed


@pytest.mark.parametrize("share", [0.45, 0.7, 0.99])
def test_all_whole_chunks_up_to_the_cut_are_kept_with_times_numbers_and_origin(
    recording: Recording, tmp_path: Path, share: float
) -> None:
    path, _ = recording
    content = path.read_bytes()
    with RunReader(path) as run:
        chunks = run.outline.chunks
    cut_at = int(share * (chunks[-1].offset + chunks[-1].length))
    out, recovery = recovered(content[:cut_at], tmp_path)
    origin, messages = all_of(path)
    origin_kept, kept = all_of(out)
    assert origin_kept == origin
    whole_chunks = sum(place.offset + 9 + place.length <= cut_at for place in chunks)
    assert whole_chunks > 0
    assert kept == messages[: 1000 * whole_chunks]
    assert len(kept) == recovery.messages
    assert not recovery.lossless
    with RunReader(out) as run:
        assert run.whole
        assert run.metadata[RECOVERY_METADATA] == {
            "recovered_from": "run.mcap",
            "lossless": "false",
            "cut_bytes": str(recovery.cut_bytes),
            "damage": "",
        }


@pytest.mark.parametrize(("number", "cut_bytes"), [(2, 0), (0, 40)])
def test_a_damaged_chunk_is_left_out_and_named(
    recording: Recording, tmp_path: Path, number: int, cut_bytes: int
) -> None:
    """Also the first one, which declares the channels, of a file that has lost its index."""
    path, written = recording
    with RunReader(path) as run:
        assert is_sound(run)
        place = run.outline.chunks[number]
    content = bytearray(path.read_bytes())
    content[place.offset + 400] ^= 0xFF
    out, recovery = recovered(bytes(content[: len(content) - cut_bytes]), tmp_path)
    with RunReader(tmp_path / "run.mcap") as run:
        assert not is_sound(run)
    assert f"chunk at byte {place.offset:,}" in recovery.damage
    assert not recovery.lossless
    with RunReader(out) as run:
        assert is_sound(run)
        assert list(run.messages()) == written[: 1000 * number] + written[1000 * (number + 1) :]


def test_a_damaged_attachment_is_named_in_the_copy(recording: Recording, tmp_path: Path) -> None:
    path, written = recording
    content = bytearray(path.read_bytes())
    content[content.index(b"Four inverters")] ^= 0x80
    out, recovery = recovered(bytes(content), tmp_path)
    assert "attachment scenario.toml" in recovery.damage
    assert (recovery.messages, recovery.lossless) == (len(written), False)
    with RunReader(out) as run:
        assert run.metadata[RECOVERY_METADATA]["damage"] == recovery.damage
        assert list(run.messages()) == written
