"""`heliarch recover`: its exit status says whether a recording is whole, cut, or nothing."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import heliarch
from recordings_by_hand import whole_run, write_run

from bus_schemas.bus import Delivery
from recordings import open_run


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("recover") / "run.mcap"
    write_run(path, whole_run(100))
    return path.read_bytes()


def test_a_whole_recording_is_left_alone(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    result = heliarch("recover", tmp_path)
    assert (result.exit_code, list(tmp_path.iterdir())) == (0, [path])
    assert "it is whole, there is nothing to recover" in result.output


def test_a_cut_recording_is_recovered_beside_it_and_what_is_missing_is_said(
    content: bytes, tmp_path: Path
) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / "run.recovered.mcap"
    path.write_bytes(content[: len(content) * 2 // 3])
    result = heliarch("recover", tmp_path)
    assert result.exit_code == 3
    text = " ".join(result.stdout.split())
    with open_run(out) as run:
        assert run.whole
        assert f"kept: {sum(1 for _ in run.records()):,} messages" in text
        assert "planned for 1,000 cycles" in text
        assert f"after cycle {run.last_cycle}" in text
    assert "missing: " in text
    assert "bytes are an incomplete record" in text
    again = heliarch("recover", tmp_path)
    assert again.exit_code == 2
    assert "it exists already" in again.stderr


def is_of(cycles: range) -> Callable[[Delivery], bool]:
    return lambda pair: pair[1].cycle in cycles


def test_a_recording_with_a_cut_file_among_others_is_not_whole(
    content: bytes, tmp_path: Path
) -> None:
    """As its recorders leave it of which the second was killed."""
    for name, cycles, close in (
        ("run.mcap", range(40), True),
        ("run-2.mcap", range(40, 70), False),
        ("run-3.mcap", range(75, 101), True),
    ):
        write_run(tmp_path / name, whole_run(100), is_kept=is_of(cycles), close=close)
    with open_run(tmp_path) as run:
        assert (len(run.files), run.whole) == (3, False)
        kept = sum(1 for _ in run.records())
    assert "cut" in heliarch("inspect", tmp_path).stdout
    result = heliarch("recover", tmp_path, "--json", "-")
    assert result.exit_code == 3
    found = json.loads(result.stdout)
    assert found["messages"] == kept
    assert found["lost"] > 0
    with open_run(tmp_path / "run.recovered.mcap") as run:
        assert (len(run.files), run.whole) == (1, True)


def test_a_recording_that_lacks_its_index_alone_has_lost_nothing(
    content: bytes, tmp_path: Path
) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / "new.mcap"
    path.write_bytes(content[:-40])
    result = heliarch("recover", path, "--out", out, "--json", "-")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["lossless"] is True
    with open_run(out) as run:
        assert run.whole


def test_of_a_recording_cut_before_its_first_message_nothing_is_recovered(
    content: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(content)
    with open_run(path) as run:
        first = run.outline.chunks[0].offset
    for length in (0, 8, 300, first, first + 100):
        path.write_bytes(content[:length])
        result = heliarch("recover", path)
        assert (result.exit_code, list(tmp_path.iterdir())) == (1, [path])
        assert "there is nothing to recover" in result.stderr


@pytest.mark.parametrize("length", [2**64 - 1, 2**40, 100, 0])
def test_behind_a_chunk_of_a_wrong_length_nothing_is_kept(
    content: bytes, tmp_path: Path, length: int
) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / "new.mcap"
    path.write_bytes(content)
    with open_run(path) as run:
        place, end = run.outline.chunks[3], run.outline.readable_end
    torn = bytearray(content[: end - 20])
    torn[place.offset + 1 : place.offset + 9] = length.to_bytes(8, "little")
    path.write_bytes(torn)
    result = heliarch("recover", path, "--out", out)
    assert result.exit_code == 3, result.output
    assert "missing: " in result.stdout
    with open_run(out) as run:
        assert sum(1 for _ in run.records()) == 4 * 200


def test_messages_out_of_an_incomplete_chunk_are_called_unverified(
    content: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    write_run(path, whole_run(100), messages_per_chunk=2000)
    with open_run(path) as run:
        first = run.outline.chunks[0]
    path.write_bytes(path.read_bytes()[: first.offset + first.length - 5])
    assert "they have no checksum and may be damaged" in " ".join(
        heliarch("recover", path).stdout.split()
    )
