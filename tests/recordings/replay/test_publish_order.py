"""The bytes of a recording come in the order in which they were published, from any cycle on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from replayed_runs import Said, run_in_memory, without, write

from bus_schemas.codec import encode
from bus_schemas.signals import RUN
from recordings.read.reader import RunReader
from recordings.replay.publish_order import complete_cycles, in_publish_order

SAID = run_in_memory()


def payloads(said: list[Said]) -> list[bytes]:
    """What was on the wire."""
    return [encode(message) for _, message, _ in said]


def test_what_was_recorded_in_batches_comes_as_it_was_published(tmp_path: Path) -> None:
    generator = np.random.default_rng(1)
    order = np.argsort(np.arange(len(SAID)) + generator.uniform(0.0, 40.0, len(SAID)))
    last_ns = SAID[-1].logged_ns
    mixed = [
        SAID[place]._replace(logged_ns=last_ns + rank * 1_000) for rank, place in enumerate(order)
    ]
    assert payloads(mixed) != payloads(SAID)
    with RunReader(write(tmp_path / "run", mixed)) as reader:
        assert [record.payload for record in in_publish_order(reader)] == payloads(SAID)


def test_of_a_run_that_broke_off_the_last_cycles_do_not_count_as_complete(tmp_path: Path) -> None:
    broken = without(SAID, lambda entry: entry.port.signal is RUN and entry.message.cycle > 0)
    with RunReader(write(tmp_path / "run", broken[: len(broken) * 3 // 4])) as reader:
        assert 0 < complete_cycles(reader) <= reader.last_cycle < 39
        counts = [0] * complete_cycles(reader)
        for record in in_publish_order(reader, before_cycle=complete_cycles(reader)):
            counts[record.cycle] += 1
    complete = [0] * 40
    for entry in broken:
        complete[entry.message.cycle] += 1
    assert counts == complete[: len(counts)]
