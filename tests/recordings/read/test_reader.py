"""A part of a recording is the same as that part of all of it, and is found without the rest."""

from __future__ import annotations

import warnings
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from memory_use import traced_memory
from plans_by_hand import with_changes
from recordings_by_hand import PLAN, cut, cycle_of_the_plant, whole_run, write_run, zero_chunk

from bus_schemas.bus import Delivery
from bus_schemas.errors import InputError, InputWarning
from bus_schemas.signals import PRODUCTION, RUN, SIGNALS, TELEMETRY
from bus_schemas.tree import ROOT
from recordings.inspect.overview import read_overview
from recordings.read.mcap_file import Chunk, read_outline
from recordings.read.reader import RunReader

CYCLES = 300

Recording = tuple[Path, list[Delivery]]
"""A file, and what was written into it."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("reader") / "run.mcap"
    return path, write_run(path, whole_run(CYCLES))


@pytest.fixture
def run(recording: Recording) -> RunReader:
    return RunReader(recording[0])


names = [signal.name for signal in SIGNALS if signal.logged]


@settings(max_examples=30, deadline=None)
@given(
    signals=st.lists(st.sampled_from(names), unique=True, max_size=3),
    nodes=st.lists(st.sampled_from(["central", "c1", "c2/d"]), unique=True),
    bounds=st.lists(st.integers(0, CYCLES), min_size=2, max_size=2, unique=True),
)
def test_signals_nodes_and_cycles_choose_from_all_messages(
    recording: Recording, signals: list[str], nodes: list[str], bounds: list[int]
) -> None:
    path, written = recording
    start, end = sorted(bounds)
    with RunReader(path) as run:
        found = run.messages(*signals, nodes=nodes, start=start, end=end)
        paths = {"" if node == "central" else node for node in nodes}
        assert list(found) == [
            (port, message)
            for port, message in written
            if (not signals or port.signal.name in signals)
            and (not nodes or port.node in paths)
            and start <= message.cycle < end
        ]


class CountingReader(RunReader):
    """Counts the chunks that it unpacks."""

    unpacked = 0

    def unpack(self, chunk: Chunk) -> bytes:
        self.unpacked += 1
        return super().unpack(chunk)


def test_some_cycles_are_found_without_the_rest(recording: Recording) -> None:
    run = CountingReader(recording[0])
    with run:
        assert len(run.outline.chunks) > 40
        assert len(list(run.messages(TELEMETRY, start=200, end=204))) == 4 * 4
        assert run.unpacked < 15, "some to search for the place, and those around it"


def test_the_last_cycle_is_that_of_the_last_message(run: RunReader, tmp_path: Path) -> None:
    assert (run.last_cycle, run.stop_cycle) == (CYCLES - 1, CYCLES)
    path = tmp_path / "run.mcap"
    write_run(path, [(RUN.of(ROOT), PLAN.run_message("start", 0, 1))])
    with RunReader(path) as empty:
        assert (empty.last_cycle, empty.stop_cycle) == (-1, None)
        assert len(list(empty.messages())) == 1
    start, *cycles, stop = whole_run(5)
    forged = [(RUN.of(ROOT), PLAN.run_message("stop", cycle, 1)) for cycle in (4, 90, 2)]
    write_run(tmp_path / "forged.mcap", [start, *forged, *cycles, stop])
    with RunReader(tmp_path / "forged.mcap") as contradicted:
        assert contradicted.stop_cycle == 5


def test_messages_that_come_late_are_found_by_their_cycle(tmp_path: Path) -> None:
    # In memory none is further behind than the longest period of a tier; here one cycle less.
    path = tmp_path / "run.mcap"
    order = list(range(100))
    for cycle in range(0, 98, 3):
        order[cycle], order[cycle + 2] = order[cycle + 2], order[cycle]
    write_run(
        path,
        (delivery for cycle in order for delivery in cycle_of_the_plant(cycle)),
        messages_per_chunk=20,
    )
    with RunReader(path) as run:
        for cycle in range(100):
            found = run.messages(PRODUCTION, start=cycle, end=cycle + 1)
            assert [message.cycle for _, message in found] == [cycle]


@pytest.mark.parametrize("share", [0.2, 0.77])
def test_a_cut_recording_is_read_up_to_the_cut(
    recording: Recording, tmp_path: Path, share: float
) -> None:
    path, written = recording
    cut(path, tmp_path / "run.mcap", share)
    with RunReader(tmp_path) as run:
        found = list(run.messages())
        assert not run.whole
        assert found == written[: len(found)]
        assert len(found) > 0.5 * share * len(written)
        last = found[-1][1].cycle
        ends = [pair for pair in found if pair[1].cycle == last]
        assert list(run.messages(start=last)) == ends


def test_a_damaged_summary_is_not_believed(recording: Recording) -> None:
    content = recording[0].read_bytes()
    whole, size = read_outline(BytesIO(content)), len(content)
    for place in (*range(whole.readable_end, size, 499), *range(size - 37, size)):
        torn = bytearray(content)
        torn[place] ^= 0x55
        outline = read_outline(BytesIO(torn))
        assert (outline.whole, outline.chunks) == (False, whole.chunks), place


# Plan, scenario and metadata are in the first hundredth of the file.
place = st.floats(0.0001, 0.01) | st.floats(0.01, 1.0, exclude_max=True)
byte = st.tuples(place, st.integers(0, 255))


@settings(max_examples=30)
@given(damage=st.lists(byte, min_size=5, max_size=5))
def test_a_torn_file_never_breaks_the_reading(
    recording: Recording, damage: list[tuple[float, int]]
) -> None:
    torn = bytearray(recording[0].read_bytes())
    for place, value in damage:
        torn[int(place * len(torn))] = value
    assert read_outline(BytesIO(torn)).readable_end <= len(torn)


def test_the_empty_file_of_a_recorder_that_was_killed_at_once_hides_no_later_one(
    tmp_path: Path,
) -> None:
    write_run(tmp_path / "run.mcap", whole_run(10), is_kept=lambda pair: pair[1].cycle < 5)
    (tmp_path / "run-2.mcap").touch()
    write_run(tmp_path / "run-3.mcap", whole_run(10), is_kept=lambda pair: pair[1].cycle >= 7)
    with RunReader(tmp_path) as run:
        assert run.damage_text().endswith("hold nothing of this run (run-2.mcap)")
        cycles = [message.cycle for _, message in run.messages(PRODUCTION)]
        assert cycles == [*range(5), *range(7, 10)]
        assert not run.whole


# Bad input ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("signals", "nodes", "start", "complaint"),
    [
        (["imp"], [], None, "signals: .*got 'imp'; did you mean impp"),
        (["ready"], [], None, "signals: .*telemetry.*got 'ready'"),
        ([], ["c1/aa"], None, "nodes: .*got 'c1/aa'; did you mean c1/a"),
        ([], ["centrl"], None, "nodes: .*got 'centrl'; did you mean central"),
        ([], ["?"], None, "nodes: .*central, c1, c2, c1/a"),
        ([], [], "13:49", "start: .*2010-04-01 12:00:00 to 2010-04-01 12:04:59"),
    ],
)
def test_unknown_names_are_refused_with_the_known_ones(
    run: RunReader, signals: list[str], nodes: list[str], start: str | None, complaint: str
) -> None:
    with pytest.raises(InputError, match=complaint) as caught:
        run.messages(*signals, nodes=nodes, start=start)
    assert "\n" not in str(caught.value)


def test_a_damaged_chunk_is_skipped_and_named_where_it_would_have_been_read(
    recording: Recording, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    chunk = zero_chunk(recording[0], 20, path)
    _, written = recording
    with (
        pytest.warns(InputWarning, match=f"chunk at byte {chunk.offset:,}"),
        RunReader(path) as run,
    ):
        assert list(run.messages()) == written[:4000] + written[4200:]
    with warnings.catch_warnings(action="error"), RunReader(path) as run:
        assert list(run.messages(end=50)) == [pair for pair in written if pair[1].cycle < 50]


@pytest.mark.parametrize("ahead", [5, 700])
def test_a_device_that_states_later_cycles_moves_no_end(tmp_path: Path, ahead: int) -> None:
    plan = with_changes(PLAN, external=("c2/c",))
    deliveries = list(whole_run(60))
    for _, message in deliveries:
        if message.source == "c2/c":
            message.cycle += ahead
    # Chunks that begin with a message of the device.
    deliveries.sort(key=lambda pair: pair[1].cycle - ahead * (pair[1].source == "c2/c"))
    write_run(tmp_path / "run.mcap", deliveries, plan=plan, messages_per_chunk=7)
    with RunReader(tmp_path / "run.mcap") as run:
        assert (run.last_cycle, run.stop_cycle) == (59, 60)
        impps = run.frames("impp", nodes="c1/a", start=20, end=30)["impp"]
        assert list(impps.cycle) == [*range(20, 30)]
        overview = read_overview(run)
    assert (overview.last_cycle, overview.complete_cycles) == (59, 60)
    assert {span.agent for span in overview.states} <= {"c2/c"}


@pytest.mark.parametrize("table", ["impp", "production_inverters"])
def test_a_frame_takes_little_more_memory_than_its_columns(tmp_path: Path, table: str) -> None:
    write_run(tmp_path / "run.mcap", whole_run(1000))
    with RunReader(tmp_path) as run:
        run.frames(table, end=10)  # What is imported and kept once.
        with traced_memory() as memory:
            frame = run.frames(table)[table]
            _, peak = memory()
    assert peak < 2.0 * frame.memory_usage(index=True).sum() + 300_000
