"""`heliarch recover`: its exit status says whether a recording is whole, cut, or nothing."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import heliarch, refusal
from recordings_by_hand import numbered, whole_run, write_messages, write_run

from recordings.read.mcap_file import Outline
from recordings.read.reader import RunReader

Spoil = Callable[[bytes, Outline], bytes]
PER_CHUNK = 200


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, Outline]:
    """A recording of 100 cycles, and where its parts are."""
    path = tmp_path_factory.mktemp("recover") / "run.mcap"
    write_run(path, whole_run(100), messages_per_chunk=PER_CHUNK)
    with RunReader(path) as run:
        return path.read_bytes(), run.outline


def with_length(length: int) -> Spoil:
    """Without its index, and the length of its fourth chunk wrong."""

    def spoil(content: bytes, outline: Outline) -> bytes:
        torn, place = bytearray(content[: outline.readable_end - 20]), outline.chunks[3].offset
        torn[place + 1 : place + 9] = length.to_bytes(8, "little")
        return bytes(torn)

    return spoil


@pytest.mark.parametrize(
    ("spoil", "status", "said", "chunks"),
    [
        (lambda content, _: content, 0, "it is whole, there is nothing to recover", None),
        (lambda content, _: content[:-40], 0, "missing: nothing", None),
        (lambda content, _: content[: len(content) // 3], 3, "an incomplete record", None),
        (lambda *_: b"", 1, "there is nothing to recover", None),
        (lambda content, at: content[: at.chunks[0].offset + 9], 1, "nothing to recover", None),
        (with_length(2**64 - 1), 3, "", 15),
        (with_length(100), 3, "", 14),
    ],
)
def test_the_exit_status_says_what_became_of_a_recording(
    whole: tuple[bytes, Outline],
    tmp_path: Path,
    spoil: Spoil,
    status: int,
    said: str,
    chunks: int | None,
) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / "run.recovered.mcap"
    path.write_bytes(spoil(*whole))
    result = heliarch("recover", tmp_path, "--json", tmp_path / "x.json")
    text = " ".join(result.output.split())
    assert result.exit_code == status
    assert said in text
    if not out.exists():
        assert status == 1 or path.read_bytes() == whole[0]
        return
    assert json.loads((tmp_path / "x.json").read_text())["lossless"] == (status == 0)
    with RunReader(out) as run:
        assert run.whole
        kept = sum(1 for _ in run.records())
    assert f"kept: {kept:,} messages" in text
    assert chunks is None or kept == chunks * PER_CHUNK
    assert "it exists already" in refusal("recover", tmp_path)


def test_a_recording_with_a_cut_file_among_others_is_not_whole(tmp_path: Path) -> None:
    """As its recorders leave it of which the second was killed."""
    parts = {"run": (0, 40), "run-2": (40, 70), "run-3": (75, 101)}
    for name, (first, end) in parts.items():
        kept = [pair for pair in numbered(whole_run(100)) if first <= pair[1].cycle < end]
        write_messages(tmp_path / f"{name}.mcap", kept, close=name != "run-2")
    with RunReader(tmp_path) as run:
        assert (len(run.files), run.whole) == (3, False)
        count = sum(1 for _ in run.records())
    assert "cut" in heliarch("inspect", tmp_path).stdout
    result = heliarch("recover", tmp_path, "--json", "-")
    found = json.loads(result.stdout)
    assert (result.exit_code, found["messages"]) == (3, count)
    assert found["lost"] > 0
    with RunReader(tmp_path / "run.recovered.mcap") as run:
        assert (len(run.files), run.whole) == (1, True)
