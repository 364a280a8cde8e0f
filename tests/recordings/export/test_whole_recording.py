"""Of a cut or damaged recording all that can be read is in a new, whole one, bit for bit."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import heliarch
from mcap.reader import make_reader
from recordings_by_hand import cut, numbered, whole_run, write_messages, write_run, zero_chunk

from bus_schemas.bus import Delivery
from bus_schemas.errors import InputWarning
from recordings.export.exporting import export
from recordings.read.reader import RunReader
from recordings.read.run_file import RECOVERY_METADATA

PER_CHUNK = 1000

Recording = tuple[Path, list[Delivery]]
"""A file, and what was written into it."""


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    path = tmp_path / "run.mcap"
    return path, write_run(path, whole_run(100), messages_per_chunk=PER_CHUNK)


def copied(path: Path) -> Path:
    with RunReader(path) as run:
        return Path(export(run, "mcap").path)


def all_of(path: Path) -> tuple[list[object], list[object]]:
    """Everything in a file as the mcap library finds it, but for what says that it is a copy."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        metadata = [entry for entry in reader.iter_metadata() if entry.name != RECOVERY_METADATA]
        origin = [*reader.iter_attachments(), *metadata, summary.schemas, summary.channels]
        return origin, [one for *_, one in reader.iter_messages(log_time_order=False)]


@pytest.mark.parametrize("share", [0.45, 0.7, 0.99, 1.0])
def test_all_whole_chunks_up_to_the_cut_are_kept_with_times_numbers_and_origin(
    recording: Recording, share: float
) -> None:
    path, _ = recording
    origin, messages = all_of(path)
    cut(path, share=share)
    with RunReader(path) as run:
        whole_chunks, was_closed = len(run.outline.chunks), run.outline.closed
    copy = copied(path)
    kept_origin, kept = all_of(copy)
    assert kept_origin == origin
    assert kept == messages[: PER_CHUNK * whole_chunks]
    assert kept
    with RunReader(copy) as run:
        assert run.whole
        assert ("cut at byte" in run.metadata[RECOVERY_METADATA]["damage"]) == (not was_closed)


@pytest.mark.parametrize("number", [0, 2])
def test_a_damaged_chunk_is_left_out_and_named(recording: Recording, number: int) -> None:
    """Also the first one, which declares the channels."""
    path, written = recording
    place = zero_chunk(path, number)
    with pytest.warns(InputWarning, match=f"chunk at byte {place.offset:,}"):
        copy = copied(path)
    with RunReader(copy) as run:
        assert f"chunk at byte {place.offset:,}" in run.metadata[RECOVERY_METADATA]["damage"]
        kept = list(run.messages())
    assert kept == written[: PER_CHUNK * number] + written[PER_CHUNK * (number + 1) :]
    assert copy.name in heliarch("inspect", copy).stdout


def test_the_files_of_several_recorders_become_one(tmp_path: Path) -> None:
    """As they are left where the second recorder was killed."""
    parts = {"run": (0, 40), "run-2": (40, 70), "run-3": (75, 101)}
    for name, (first, end) in parts.items():
        kept = [pair for pair in numbered(whole_run(100)) if first <= pair[1].cycle < end]
        write_messages(tmp_path / f"{name}.mcap", kept, close=name != "run-2")
    with RunReader(tmp_path) as run:
        assert (len(run.files), run.whole) == (3, False)
        before = list(run.records())
    said = heliarch("export", tmp_path, "--format", "mcap").stdout
    assert "cut short" in " ".join(said.split())
    with RunReader(tmp_path / "run.recovered.mcap") as run:
        assert (len(run.files), run.whole) == (1, True)
        assert list(run.records()) == before
