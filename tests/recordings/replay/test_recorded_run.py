"""A recorded gives the bytes of a recording in the order of their publishing, from any cycle on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from recordings.replay.recorded_run import RecordedRun
from replayed_runs import PLAN, STEP_NS, Said, run_in_memory, without, write

from bus_schemas.codec import encode
from bus_schemas.errors import InputError
from bus_schemas.signals import COMMAND, IMPP, RUN

SAID = run_in_memory()


def payloads(said: list[Said]) -> list[bytes]:
    """What was on the wire."""
    return [encode(message) for _, message, _ in said]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 40 cycles."""
    return write(tmp_path_factory.mktemp("recorded") / "run", SAID)


def test_all_that_was_said_comes_byte_by_byte(whole: Path) -> None:
    with RecordedRun(whole) as recorded:
        records = list(recorded.records())
    assert [record.payload for record in records] == payloads(SAID)
    assert [record.port for record in records] == [port for port, _, _ in SAID]


def test_what_was_recorded_in_batches_comes_as_it_was_published(tmp_path: Path) -> None:
    generator = np.random.default_rng(1)
    order = np.argsort(np.arange(len(SAID)) + generator.uniform(0.0, 40.0, len(SAID)))
    last_ns = SAID[-1].logged_ns
    mixed = [
        SAID[place]._replace(logged_ns=last_ns + rank * 1_000) for rank, place in enumerate(order)
    ]
    assert payloads(mixed) != payloads(SAID)
    with RecordedRun(write(tmp_path / "run", mixed)) as recorded:
        assert [record.payload for record in recorded.records()] == payloads(SAID)


def test_what_was_published_at_one_moment_keeps_the_order_of_the_file(tmp_path: Path) -> None:
    same = [entry._replace(message=replace(entry.message, publish_time_ns=5)) for entry in SAID]
    with RecordedRun(write(tmp_path / "run", same)) as recorded:
        assert [record.payload for record in recorded.records()] == payloads(same)


def test_a_message_that_was_recorded_seconds_late_comes_late_but_comes(tmp_path: Path) -> None:
    slow = [
        entry._replace(
            message=replace(entry.message, publish_time_ns=place * 20_000_000),
            logged_ns=place * 20_000_000,
        )
        for place, entry in enumerate(SAID)
    ]
    late = slow.pop(100)
    slow.insert(400, late._replace(logged_ns=slow[400].logged_ns))
    with RecordedRun(write(tmp_path / "run", slow)) as recorded:
        found = [record.payload for record in recorded.records()]
    assert sorted(found) == sorted(payloads(slow))
    assert found.index(encode(late.message)) > 300


@pytest.mark.parametrize(("first", "before"), [(0, 1), (7, 8), (13, None), (0, 40), (38, 200)])
def test_a_span_of_cycles_is_what_the_whole_has_of_them(
    whole: Path, first: int, before: int | None
) -> None:
    wanted = [entry for entry in SAID if first <= entry.message.cycle < (before or len(SAID))]
    with RecordedRun(whole) as recorded:
        found = [record.payload for record in recorded.records(None, first, before)]
    assert found == payloads(wanted)
    assert found


def test_some_ports_are_what_the_whole_has_of_them(whole: Path) -> None:
    wanted = {IMPP.of("c1/a"), COMMAND.of("c2/d")}
    with RecordedRun(whole) as recorded:
        found = [record.payload for record in recorded.records(wanted)]
    assert found == payloads(without(SAID, lambda entry: entry.port not in wanted))
    assert len(found) == 80


def test_a_run_that_came_to_its_end_is_complete(whole: Path) -> None:
    with RecordedRun(whole) as recorded:
        assert (recorded.cycles, recorded.complete_cycles, recorded.whole) == (40, 40, True)


def test_of_a_run_that_broke_off_the_last_cycles_do_not_count_as_complete(tmp_path: Path) -> None:
    broken = without(SAID, lambda entry: entry.port.signal is RUN and entry.message.cycle > 0)
    with RecordedRun(write(tmp_path / "run", broken[: len(broken) * 3 // 4])) as recorded:
        assert 0 < recorded.complete_cycles < recorded.cycles < 40
        counts = [0] * recorded.complete_cycles
        for record in recorded.records(before_cycle=recorded.complete_cycles):
            counts[record.cycle] += 1
    complete = [0] * 40
    for entry in broken:
        complete[entry.message.cycle] += 1
    assert counts == complete[: len(counts)]


def test_a_cut_file_is_a_tape_up_to_the_cut(whole: Path, tmp_path: Path) -> None:
    content = (whole / "run.mcap").read_bytes()
    cut = tmp_path / "run.mcap"
    cut.write_bytes(content[: len(content) // 2])
    with RecordedRun(cut) as recorded:
        found = [record.payload for record in recorded.records()]
        assert not recorded.whole
    assert found == payloads(SAID)[: len(found)]
    assert len(found) > 100


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        RecordedRun(tmp_path / "nowhere")


def test_the_plan_is_that_of_the_run(whole: Path) -> None:
    with RecordedRun(whole) as recorded:
        assert recorded.plan == PLAN
        assert (
            next(recorded.records()).log_time_ns - next(recorded.records()).publish_time_ns == 1_000
        )
    assert SAID[0].message.publish_time_ns == STEP_NS
