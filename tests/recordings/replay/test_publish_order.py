"""How many cycles of a recording are complete, and what was published in them."""

from __future__ import annotations

from pathlib import Path

from replayed_runs import run_in_memory, write

from bus_schemas.signals import RUN
from recordings.read.reader import RunReader
from recordings.replay.publish_order import complete_cycles, in_publish_order

SAID = run_in_memory()


def test_of_a_run_that_broke_off_the_last_cycles_do_not_count_as_complete(tmp_path: Path) -> None:
    broken = [said for said in SAID if said.port.signal is not RUN or not said.message.cycle]
    with RunReader(write(tmp_path / "run", broken[: len(broken) * 3 // 4])) as reader:
        assert 0 < complete_cycles(reader) <= reader.last_cycle < 39
        counts = [0] * complete_cycles(reader)
        for record in in_publish_order(reader, before_cycle=complete_cycles(reader)):
            counts[record.cycle] += 1
    complete = [0] * 40
    for entry in broken:
        complete[entry.message.cycle] += 1
    assert counts == complete[: len(counts)]
