"""A file is the same whether it is found by its index or by walking, and wherever it was cut."""

from __future__ import annotations

from io import BytesIO

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings_by_hand import whole_run, write_run

from recordings.outline import MAGIC, NoMcapError, Outline, read_outline


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
