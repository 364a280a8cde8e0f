"""A file is the same whether it is found by its index or by walking, and wherever it was cut."""

from __future__ import annotations

from io import BytesIO

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings_by_hand import PLAN, whole_run, write_run

from recordings.read.outline import MAGIC, NoMcapError, Outline, read_outline
from recordings.read.run_file import declare


class Content(bytes):
    """A file's bytes; what hypothesis shows of them in an error is short."""

    def __repr__(self) -> str:
        return f"<{len(self)} bytes>"


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("outline") / "run.mcap"
    write_run(path, whole_run(20), messages_per_chunk=100)
    return Content(path.read_bytes())


def outline_of(content: bytes) -> Outline:
    return read_outline(BytesIO(content))


def parts(outline: Outline) -> tuple[object, ...]:
    return (
        outline.header,
        outline.attachments,
        outline.metadata,
        outline.schemas,
        outline.channels,
        outline.chunks,
    )


def cut(content: bytes) -> bytearray:
    """Take the index away: the file has to be walked through."""
    return bytearray(content[: outline_of(content).readable_end - 20])


def test_walking_finds_what_the_index_says(content: bytes) -> None:
    by_index, by_walking = outline_of(content), outline_of(bytes(cut(content)))
    assert (by_index.closed, by_walking.closed) == (True, False)
    assert [entry.name for entry in by_index.attachments] == ["scenario.toml", "plan.json"]
    assert [entry.name for entry in by_index.metadata] == ["run", "clock_anchor"]
    assert len(by_index.chunks) > 4
    assert parts(by_walking) == parts(by_index)


def test_a_damaged_index_is_not_believed(content: bytes) -> None:
    by_index = outline_of(content)
    torn = bytearray(content)
    torn[(by_index.readable_end + len(content)) // 2] ^= 0xFF
    assert parts(outline_of(bytes(torn))) == parts(by_index)


@settings(max_examples=60, deadline=None)
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_a_file_cut_anywhere_has_the_chunks_before_the_cut(content: bytes, share: float) -> None:
    whole = outline_of(content)
    end = max(int(share * len(content)), len(MAGIC))
    outline = outline_of(content[:end])
    assert not outline.closed or end > whole.readable_end - 20
    assert outline.readable_end <= end
    sound = [place for place in outline.chunks if not place.cut]
    assert sound == whole.chunks[: len(sound)]
    ends = [place.offset + 9 + place.length for place in whole.chunks]
    assert len(sound) == sum(chunk_end <= end for chunk_end in ends)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_torn_file_never_breaks_the_reading(content: bytes, data: st.DataObject) -> None:
    torn = bytearray(content)
    for _ in range(5):
        torn[data.draw(st.integers(len(MAGIC), len(torn) - 1))] = data.draw(st.integers(0, 255))
    assert outline_of(bytes(torn)).size == len(content)


@pytest.mark.parametrize("content", [b"", b"x", b"cycle,power\n0,1\n"])
def test_what_does_not_begin_as_an_mcap_file_is_none(content: bytes) -> None:
    with pytest.raises(NoMcapError):
        outline_of(content)


def test_zeros_behind_a_cut_are_no_records(content: bytes) -> None:
    whole = outline_of(content)
    end = whole.chunks[2].offset
    outline = outline_of(content[:end] + bytes(5000))
    assert (outline.chunks, outline.readable_end) == (whole.chunks[:2], end)
    assert not outline.closed


@pytest.mark.parametrize("length", [2**64 - 1, 2**40, 100, 0])
def test_without_an_index_a_wrong_length_ends_the_reading(content: bytes, length: int) -> None:
    whole, torn = outline_of(content), cut(content)
    offset = whole.chunks[2].offset
    torn[offset + 1 : offset + 9] = length.to_bytes(8, "little")
    outline = outline_of(bytes(torn))
    assert outline.chunks[:2] == whole.chunks[:2]
    assert [place.offset for place in outline.chunks[2:] if place.cut] == [offset]
    assert outline.readable_end <= offset
    assert not outline.closed


@pytest.mark.parametrize("by_index", [True, False])
def test_an_attachment_with_a_wrong_checksum_is_named(content: bytes, by_index: bool) -> None:
    torn = bytearray(content) if by_index else cut(content)
    torn[content.index(b"Four inverters")] ^= 1
    outline = outline_of(bytes(torn))
    assert outline.indexed == by_index
    assert outline.damaged_attachments == ["scenario.toml"]
    assert outline_of(content).damaged_attachments == []


def test_schemas_and_channels_follow_from_the_plan(content: bytes) -> None:
    written, derived = outline_of(content), Outline(0)
    declare(derived, PLAN)
    assert (derived.schemas, derived.channels) == (written.schemas, written.channels)
