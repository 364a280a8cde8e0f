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
    assert list(by_index.metadata) == ["run", "clock_anchor"]
    assert len(by_index.chunks) > 4
    assert parts(by_walking) == parts(by_index)


def test_a_damaged_index_is_not_believed(content: bytes) -> None:
    by_index = outline_of(content)
    torn = bytearray(content)
    torn[(by_index.readable_end + len(content)) // 2] ^= 0xFF
    assert parts(outline_of(bytes(torn))) == parts(by_index)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_torn_file_never_breaks_the_reading(content: bytes, data: st.DataObject) -> None:
    torn = bytearray(content)
    for _ in range(5):
        torn[data.draw(st.integers(len(MAGIC), len(torn) - 1))] = data.draw(st.integers(0, 255))
    assert outline_of(bytes(torn)).size == len(content)


@pytest.mark.parametrize("content", [b"x", b"cycle,power\n0,1\n"])
def test_what_does_not_begin_as_an_mcap_file_is_none(content: bytes) -> None:
    with pytest.raises(NoMcapError):
        outline_of(content)


def test_zeros_behind_a_cut_are_no_records(content: bytes) -> None:
    whole = outline_of(content)
    end = whole.chunks[2].offset
    outline = outline_of(content[:end] + bytes(5000))
    assert (outline.chunks, outline.readable_end) == (whole.chunks[:2], end)
    assert not outline.closed


def test_schemas_and_channels_follow_from_the_plan(content: bytes) -> None:
    written, derived = outline_of(content), Outline(0)
    declare(derived, PLAN)
    assert (derived.schemas, derived.channels) == (written.schemas, written.channels)
