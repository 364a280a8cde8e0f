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


def test_a_whole_file_is_closed_and_has_all_its_parts(content: bytes) -> None:
    outline = outline_of(content)
    assert outline.closed
    assert [entry.name for entry in outline.attachments] == ["scenario.toml", "plan.json"]
    assert [entry.name for entry in outline.metadata] == ["run", "clock_anchor"]
    assert len(outline.chunks) > 4
    assert not any(place.cut for place in outline.chunks)


def test_walking_finds_what_the_index_says(content: bytes) -> None:
    by_index = outline_of(content)
    without_index = content[: by_index.readable_end - 20]
    by_walking = outline_of(without_index)
    assert not by_walking.closed
    assert parts(by_walking) == parts(by_index)


def test_a_damaged_index_is_not_believed(content: bytes) -> None:
    by_index = outline_of(content)
    torn = bytearray(content)
    torn[(by_index.readable_end + len(content)) // 2] ^= 0xFF
    assert parts(outline_of(bytes(torn))) == parts(by_index)


def test_zeros_behind_a_cut_are_no_records(content: bytes) -> None:
    whole = outline_of(content)
    end = whole.chunks[2].offset
    outline = outline_of(content[:end] + bytes(5000))
    assert outline.chunks == whole.chunks[:2]
    assert not outline.closed
    assert outline.readable_end == end


@settings(max_examples=60, deadline=None)
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_a_file_cut_anywhere_has_the_chunks_before_the_cut(content: bytes, share: float) -> None:
    whole = outline_of(content)
    cut = max(int(share * len(content)), len(MAGIC))
    outline = outline_of(content[:cut])
    assert not outline.closed or cut > whole.readable_end - 20
    assert outline.readable_end <= cut
    sound = [place for place in outline.chunks if not place.cut]
    assert sound == whole.chunks[: len(sound)]
    ends = [place.offset + 9 + place.length for place in whole.chunks]
    assert len(sound) == sum(end <= cut for end in ends)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_torn_file_never_breaks_the_reading(content: bytes, data: st.DataObject) -> None:
    torn = bytearray(content)
    for _ in range(5):
        torn[data.draw(st.integers(len(MAGIC), len(torn) - 1))] = data.draw(st.integers(0, 255))
    outline = outline_of(bytes(torn))
    assert outline.size == len(content)


@pytest.mark.parametrize("content", [b"", b"x", b"cycle,power\n0,1\n"])
def test_what_does_not_begin_as_an_mcap_file_is_none(content: bytes) -> None:
    with pytest.raises(NoMcapError):
        outline_of(content)


def cut(content: bytes) -> bytearray:
    """Take the index away: the file has to be walked through."""
    return bytearray(content[: outline_of(content).readable_end - 20])


@pytest.mark.parametrize("length", [2**64 - 1, 2**63, 2**40, 100, 0])
@pytest.mark.parametrize("which", [0, 2])
def test_behind_a_record_of_a_wrong_length_the_next_chunk_is_found(
    content: bytes, length: int, which: int
) -> None:
    whole, torn = outline_of(content), cut(content)
    offset = whole.chunks[which].offset
    torn[offset + 1 : offset + 9] = length.to_bytes(8, "little")
    outline = outline_of(bytes(torn))
    assert outline.chunks[which].offset == offset
    assert outline.chunks[:which] + outline.chunks[which + 1 :] == (
        whole.chunks[:which] + whole.chunks[which + 1 :]
    )
    assert not outline.closed


@pytest.mark.parametrize("length", [2**64 - 1, 3000, 0])
def test_a_wrong_length_between_chunks_hides_none(content: bytes, length: int) -> None:
    whole, torn = outline_of(content), cut(content)
    place = whole.chunks[2]
    behind = place.offset + 9 + place.length  # of a record of the index of its messages
    torn[behind + 1 : behind + 9] = length.to_bytes(8, "little")
    outline = outline_of(bytes(torn))
    assert set(whole.chunks) <= set(outline.chunks)
    assert len(outline.chunks) <= len(whole.chunks) + 1


def test_behind_zeros_in_the_middle_the_next_chunk_is_found(content: bytes) -> None:
    whole, torn = outline_of(content), cut(content)
    begin, end = whole.chunks[1].offset + 40, whole.chunks[3].offset + 100
    torn[begin:end] = bytes(end - begin)
    outline = outline_of(bytes(torn))
    assert outline.chunks[0] == whole.chunks[0]
    assert outline.chunks[-len(whole.chunks) + 4 :] == whole.chunks[4:]


@pytest.mark.parametrize("times", [(0, 0), (2**63, 2**63), (2**63, 0), (0, 2**64 - 1)])
def test_damaged_times_of_a_chunk_are_taken_from_its_messages(
    content: bytes, times: tuple[int, int]
) -> None:
    whole, torn = outline_of(content), cut(content)
    offset = whole.chunks[2].offset
    torn[offset + 9 : offset + 25] = b"".join(time.to_bytes(8, "little") for time in times)
    assert outline_of(bytes(torn)).chunks == whole.chunks


@pytest.mark.parametrize("by_index", [True, False])
def test_an_attachment_that_is_not_what_was_written_is_named(
    content: bytes, by_index: bool
) -> None:
    torn = bytearray(content) if by_index else cut(content)
    torn[content.index(b"Four inverters")] ^= 1
    outline = outline_of(bytes(torn))
    assert outline.indexed == by_index
    assert outline.damaged_attachments == ["scenario.toml"]
    assert outline_of(content).damaged_attachments == []


def test_schemas_and_channels_follow_from_the_plan(content: bytes) -> None:
    written, derived = outline_of(content), Outline(0)
    declare(derived, PLAN)
    assert derived.schemas == written.schemas
    assert derived.channels == written.channels
