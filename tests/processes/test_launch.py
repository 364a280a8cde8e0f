"""The whole plant as real processes over real Zenoh."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec
import pytest
from running import Heliarch, assert_none_left

from bus_schemas.messages import Message
from bus_schemas.signals import COMMAND, HELP, IMPP, RESIDUAL, SETPOINT
from launch_scripts.summary import RunSummary
from recordings.reader import RunReader

pytestmark = pytest.mark.processes

Start = Callable[..., Heliarch]


def decisions(folder: Path) -> dict[tuple[str, int], Message]:
    """All that the controllers of a run decided, without the time at which it went out.

    Of what a device says several times in a cycle, the first.
    """
    found: dict[tuple[str, int], Message] = {}
    signals = (IMPP, RESIDUAL, HELP, SETPOINT, COMMAND)
    with RunReader(folder) as reader:
        for port, message in reader.messages(*signals, by_time=False):
            timeless = msgspec.structs.replace(message, publish_time_ns=0)
            found.setdefault((str(port), message.cycle), timeless)
    return found


def summary_of(folder: Path) -> RunSummary:
    """Return the summary that a run wrote, with what is in it checked."""
    document = msgspec.json.decode((folder / "summary.json").read_bytes())
    return msgspec.convert(document, RunSummary)


CYCLES = 60


class SideBySide(NamedTuple):
    """Two plants of processes that ran at the same time, and the first of them in one process."""

    one: Heliarch
    other: Heliarch
    simulated: Heliarch


@pytest.fixture(scope="module")
def side_by_side(lasting_heliarch: Start) -> SideBySide:
    words = ("oahu", "--duration", str(CYCLES), "--seed")
    one = lasting_heliarch("launch", *words, "3", "--json", "-")
    other = lasting_heliarch("launch", *words, "2")
    assert (one.wait(), other.wait()) == (0, 0), one.error_text() + other.error_text()
    simulated = lasting_heliarch("simulate", *words, "3")
    assert simulated.wait() == 0, simulated.error_text()
    return SideBySide(one, other, simulated)


def test_processes_decide_bit_for_bit_what_one_process_decides(side_by_side: SideBySide) -> None:
    ours, theirs = decisions(side_by_side.one.folder), decisions(side_by_side.simulated.folder)
    assert len(ours) > CYCLES * 21 * 2
    assert ours == theirs
    assert_none_left(side_by_side.one.folder)


def test_every_message_that_was_published_is_in_the_recording(side_by_side: SideBySide) -> None:
    run = side_by_side.one
    summary = summary_of(run.folder)
    with RunReader(run.folder) as reader:
        recorded = [port.signal.name for port, _ in reader.messages()]
    counts = {count.signal: count.recorded for count in summary.messages}
    assert counts["telemetry"] == CYCLES * 17
    assert counts["impp"] == CYCLES * 21
    assert {name: recorded.count(name) for name in counts} == counts


def test_two_plants_side_by_side_do_not_hear_each_other(side_by_side: SideBySide) -> None:
    for run in (side_by_side.one, side_by_side.other):
        summary = summary_of(run.folder)
        assert (summary.cycles, summary.lost, summary.dropped) == (CYCLES, 0, {})
    assert decisions(side_by_side.one.folder) != decisions(side_by_side.other.folder)


def test_the_summary_goes_to_standard_output_alone_if_asked_for(side_by_side: SideBySide) -> None:
    document = msgspec.json.decode(side_by_side.one.output.read_bytes())
    assert document["cycles"] == CYCLES
    assert document["messages_lost"] == 0
    assert "armed" in side_by_side.one.error_text()


def test_a_deeper_and_larger_plant_decides_alike_too(heliarch: Start) -> None:
    words = ("valley", "--duration", "10", "--seed", "3")
    launched = heliarch("launch", *words)
    assert launched.wait() == 0, launched.error_text()
    simulated = heliarch("simulate", *words)
    assert simulated.wait() == 0, simulated.error_text()
    ours = decisions(launched.folder)
    assert len(ours) > 10 * 76 * 2
    assert ours == decisions(simulated.folder)
    assert_none_left(launched.folder)
