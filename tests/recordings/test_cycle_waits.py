"""Who waited for whom in a cycle: found from the publish times of recordings made by hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace
from recordings_by_hand import PLAN, SCENARIO, cycle_of_the_plant

from bus_schemas.bus import Delivery
from bus_schemas.codec import encode
from bus_schemas.errors import InputError
from bus_schemas.messages import Message, Run
from bus_schemas.signals import COMMAND, PRODUCTION, RUN, Port
from bus_schemas.tree import ROOT
from recordings.cycle_waits import (
    CycleWaits,
    last_cycle_with_all,
    loop_times_ns,
    response_times_ns,
    slowest_cycles,
)
from recordings.reader import RunReader
from recordings.writer import RunWriter

START_NS = 5_000_000_000
CYCLE_MS = 100
REAL_TIME = replace(PLAN, cycle_wall_ns=CYCLE_MS * 1_000_000, period_cycles=(1, 1))

PUBLISHED_MS = {
    "dispatch": 0.9,
    "c1/a/telemetry": 1.0,
    "c1/b/telemetry": 1.1,
    "c2/c/telemetry": 1.2,
    "c2/d/telemetry": 1.3,
    "c1/request": 2.0,
    "c2/request": 2.1,
    "c1/a/request": 3.0,
    "c1/b/request": 3.1,
    "c2/c/request": 3.2,
    "c2/d/request": 3.3,
    "c1/a/impp": 4.0,
    "c1/a/residual": 4.1,
    "c1/a/help": 4.15,
    "c1/b/impp": 4.2,
    "c1/b/residual": 4.3,
    "c2/d/impp": 4.4,
    "c2/d/residual": 4.5,
    "c1/impp": 5.0,
    "c1/residual": 5.1,
    "c2/c/impp": 9.0,
    "c2/c/residual": 9.1,
    "c2/impp": 10.0,
    "c2/residual": 10.1,
    "impp": 11.0,
    "residual": 11.1,
    "c1/setpoint": 11.5,
    "c2/setpoint": 11.6,
    "c1/a/setpoint": 12.0,
    "c1/b/setpoint": 12.1,
    "c2/c/setpoint": 12.2,
    "c2/d/setpoint": 12.3,
    "c1/a/command": 13.0,
    "c1/b/command": 13.1,
    "c2/c/command": 13.2,
    "c2/d/command": 13.4,
    "production": 14.0,
}
"""A cycle in which `c2/c` is slow to estimate: everybody waits for it but c1."""


def in_time(cycle: int, published_ms: dict[str, float]) -> Iterator[Delivery]:
    """One cycle, published at these times after its tick; what has none is not said."""
    # The periods of the plan by hand are (2, 1): its even cycles are those in which all act.
    for port, message in cycle_of_the_plant(2 * cycle):
        if str(port) in published_ms:
            time_ns = START_NS + round((cycle * CYCLE_MS + published_ms[str(port)]) * 1e6)
            yield port, replace(message, cycle=cycle, publish_time_ns=time_ns)


def without_command_of_d(deliveries: Iterator[Delivery]) -> Iterator[Delivery]:
    """The same, and the plant says that it went on without the command of `c2/d`."""
    for port, message in deliveries:
        silent = port is PRODUCTION.of(ROOT)
        yield port, replace(message, missing=("c2/d/command",)) if silent else message


def recorded(
    folder: Path,
    *cycles: Iterator[Delivery],
    wall_ns: int = 100_000_000,
    logged_ns: int | None = None,
    begin: Run | None = None,
) -> Path:
    """A recording of these cycles, each message logged when it was published, or all at once."""
    plan = replace(REAL_TIME, cycle_wall_ns=wall_ns)
    writer = RunWriter(folder / "run.mcap", plan, SCENARIO, driver="launch")
    run: list[tuple[Port[Message], Message]] = [
        (RUN.of(ROOT), begin or plan.run_message("start", 0, START_NS))
    ]
    for port, message in (*run, *(entry for cycle in cycles for entry in cycle)):
        writer.add(port, message, encode(message), logged_ns or message.publish_time_ns)
    writer.close()
    return folder


def slowest(path: Path, count: int = 1) -> list[CycleWaits]:
    with RunReader(path) as reader:
        return slowest_cycles(reader, count)


def ms(time_ns: int) -> float:
    return round(time_ns / 1e6, 6)


def test_the_chain_leads_from_the_tick_through_whoever_was_waited_for(tmp_path: Path) -> None:
    (cycle,) = slowest(recorded(tmp_path, in_time(0, PUBLISHED_MS)))
    assert [(w.agent, w.stage, ms(w.began_ns), ms(w.ended_ns)) for w in cycle.chain] == [
        ("plant", "begin", 0.0, 0.9),
        ("central", "request", 0.9, 2.1),
        ("c2", "request", 2.1, 3.2),
        ("c2/c", "estimate", 3.2, 9.1),
        ("c2", "report", 9.1, 10.1),
        ("central", "solve", 10.1, 11.6),
        ("c2", "solve", 11.6, 12.3),
        ("c2/d", "actuate", 12.3, 13.4),
        ("plant", "advance", 13.4, 14.0),
    ]
    assert cycle.in_words() == "cycle 0: 14.0 ms, c2/c took 5.9 ms to estimate"
    assert ms(cycle.loop_ns) == 14.0


def test_a_plant_that_names_an_impossible_beginning_is_not_believed(tmp_path: Path) -> None:
    begin = replace(
        REAL_TIME.run_message("start", 0, START_NS),
        start_time_ns=START_NS + 3_600_000_000_000,
        publish_time_ns=START_NS,
    )
    (cycle,) = slowest(recorded(tmp_path, in_time(0, PUBLISHED_MS), begin=begin))
    assert ms(cycle.loop_ns) == 14.0


def test_each_stage_of_each_agent_that_spoke_has_its_wait(tmp_path: Path) -> None:
    (cycle,) = slowest(recorded(tmp_path, in_time(0, PUBLISHED_MS)))
    places = {(wait.agent, wait.stage): wait for wait in cycle.waits}
    assert len(places) == len(cycle.waits) == 2 + 2 + 2 * 3 + 4 * 2
    estimate = places["c1/a", "estimate"]
    assert (ms(estimate.began_ns), ms(estimate.ended_ns)) == (3.0, 4.15)
    assert (str(estimate.cause), str(estimate.message)) == ("c1/a/request", "c1/a/help")
    assert places["plant", "begin"].cause is None


def test_cycles_are_ranked_by_their_loop_counted_from_the_scheduled_tick(tmp_path: Path) -> None:
    late = {name: time_ms + 30.0 for name, time_ms in PUBLISHED_MS.items()}
    path = recorded(tmp_path, in_time(0, PUBLISHED_MS), in_time(1, late), in_time(2, PUBLISHED_MS))
    first, second = slowest(path, 2)
    assert (first.cycle, ms(first.loop_ns)) == (1, 44.0)
    assert ms(second.loop_ns) == 14.0
    # The tick itself came late: nobody but the plant is to blame.
    assert first.slowest.in_words() == "plant took 30.9 ms to begin the cycle"
    with RunReader(path) as reader:
        assert [ms(loop_ns) for loop_ns in loop_times_ns(reader)] == [14.0, 44.0, 14.0]


def test_who_was_silent_up_to_the_deadline_is_named(tmp_path: Path) -> None:
    silent = {**PUBLISHED_MS, "production": 90.0}
    del silent["c2/d/command"]
    (cycle,) = slowest(recorded(tmp_path, without_command_of_d(in_time(0, silent))))
    assert cycle.slowest.in_words() == "plant took 76.8 ms to go on, without c2/d/command"


def test_a_plant_that_gave_the_cycle_up_waited_for_nobody(tmp_path: Path) -> None:
    """It stood still over the cycle: its commands came, but it did not look."""
    stood = {**PUBLISHED_MS, "production": 877.0}
    del stood["c2/d/command"]
    words = ("skipped@1", *(f"{leaf}/command" for leaf in REAL_TIME.tree.leaves))
    given_up = (
        (port, replace(message, missing=words) if port is PRODUCTION.of(ROOT) else message)
        for port, message in in_time(1, stood)
    )
    (cycle,) = slowest(recorded(tmp_path, in_time(0, PUBLISHED_MS), given_up))
    assert cycle.in_words() == "cycle 1: 877.0 ms, plant gave the cycle up"
    (wait,) = cycle.chain
    assert (wait.agent, wait.stage, ms(wait.began_ns), ms(wait.ended_ns)) == (
        "plant",
        "advance",
        0.0,
        877.0,
    )


def test_who_answered_after_the_deadline_is_in_the_chain(tmp_path: Path) -> None:
    late = {**PUBLISHED_MS, "production": 90.0, "c2/d/command": 95.0}
    (cycle,) = slowest(recorded(tmp_path, without_command_of_d(in_time(0, late))))
    assert [(wait.agent, wait.stage) for wait in cycle.chain[-2:]] == [
        ("c2/d", "actuate"),
        ("plant", "advance"),
    ]
    assert cycle.slowest.in_words() == "c2/d took 77.7 ms to command"


def test_no_link_outlasts_the_one_that_waited_for_it(tmp_path: Path) -> None:
    """A slow device answers cycles later, and has heard by then what came after the end."""
    late = {
        **PUBLISHED_MS,
        "production": 90.0,
        "c2/d/command": 4675.0,
        "c2/d/impp": 4660.0,
        "c2/d/setpoint": 95.0,
    }
    (cycle,) = slowest(recorded(tmp_path, without_command_of_d(in_time(0, late))))
    assert cycle.slowest.agent == "c2/d"
    assert all(0 <= link.began_ns <= link.ended_ns <= cycle.loop_ns for link in cycle.chain)
    assert all(
        link.ended_ns <= following.ended_ns
        for link, following in zip(cycle.chain, cycle.chain[1:], strict=False)
    )


def test_a_device_answers_as_fast_as_its_last_input_and_its_own_word_tell(tmp_path: Path) -> None:
    slow = {**PUBLISHED_MS, "c2/d/command": 15.0, "production": 16.0}
    path = recorded(tmp_path, in_time(0, PUBLISHED_MS), in_time(1, slow))
    with RunReader(path) as reader:
        found = response_times_ns(reader, ["c2/d"])
        assert response_times_ns(reader, []) == {}
    assert {place: [ms(time_ns) for time_ns in times] for place, times in found.items()} == {
        ("c2/d", "estimate"): [1.2, 1.2],
        ("c2/d", "actuate"): [1.1, 2.7],
    }


def test_a_run_in_lockstep_has_no_scheduled_ticks(tmp_path: Path) -> None:
    path = recorded(tmp_path, in_time(0, PUBLISHED_MS), wall_ns=0)
    with pytest.raises(InputError, match="accepted is the recording of a run at a finite pace"):
        slowest(path)


def test_of_a_message_that_came_twice_the_first_counts(tmp_path: Path) -> None:
    port = COMMAND.of("c2/d")
    again = (
        (port, replace(message, publish_time_ns=message.publish_time_ns + 500_000))
        for port_of, message in in_time(0, PUBLISHED_MS)
        if port_of is port
    )
    (cycle,) = slowest(recorded(tmp_path, in_time(0, PUBLISHED_MS), again))
    assert ms(cycle.chain[-2].ended_ns) == 13.4


def retimed(
    deliveries: Iterator[Delivery], key: str, publish_time_ns: Callable[[int], int]
) -> Iterator[Delivery]:
    """The same, with another publish time on one key."""
    for port, message in deliveries:
        time_ns = message.publish_time_ns
        found = publish_time_ns(time_ns) if str(port) == key else time_ns
        yield port, replace(message, publish_time_ns=found)


@pytest.mark.parametrize(
    "publish_time_ns",
    [
        lambda time_ns: 0,
        lambda time_ns: 4_000_000,
        lambda time_ns: time_ns - 300_000_000,
        lambda time_ns: time_ns + 1_000_000_000,
    ],
    ids=["unknown", "of another clock", "before the cycle before", "in the future"],
)
def test_impossible_publish_times_are_not_measured(
    publish_time_ns: Callable[[int], int], tmp_path: Path
) -> None:
    cycles = [in_time(cycle, PUBLISHED_MS) for cycle in range(2)]
    path = recorded(
        tmp_path,
        retimed(cycles[0], "c2/d/command", publish_time_ns),
        retimed(cycles[1], "production", publish_time_ns),
        logged_ns=START_NS + 200_000_000,
    )
    with RunReader(path) as reader:
        assert [ms(loop_ns) for loop_ns in loop_times_ns(reader)] == [14.0]
        found = response_times_ns(reader, ["c2/d", "plant"])
        (cycle,) = slowest_cycles(reader, 3)
    assert [ms(time_ns) for time_ns in found["c2/d", "actuate"]] == [1.1]
    assert len(found["plant", "advance"]) == 1
    assert cycle.chain[-2].agent == "c2/c"
    assert cycle.in_words() == "cycle 0: 14.0 ms, c2/c took 5.9 ms to estimate"


def test_after_an_interruption_only_cycles_with_all_controllers_count(tmp_path: Path) -> None:
    left = {name: time_ms for name, time_ms in PUBLISHED_MS.items() if "c2/" not in name}
    left["production"] = 90.0
    path = recorded(tmp_path, in_time(0, PUBLISHED_MS), in_time(1, left))
    with RunReader(path) as reader:
        last_cycle = last_cycle_with_all(reader, REAL_TIME.tree.leaves)
        assert last_cycle == 0
        assert [ms(loop_ns) for loop_ns in loop_times_ns(reader, last_cycle)] == [14.0]
        assert [cycle.cycle for cycle in slowest_cycles(reader, 3, last_cycle)] == [0]
        responses_ns = response_times_ns(reader, ["plant"], last_cycle)
        assert len(responses_ns["plant", "advance"]) == 1
