"""The timing of a run is computed from the times in its recording."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from msgspec.structs import replace
from plans_by_hand import with_changes
from timed_recordings import CYCLE_MS, MS, PLAN, START_NS, TIMES_MS, cycle, recorded, without

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.errors import InputError
from recordings.read.reader import RunReader
from results.timing.cycle_waits import CycleWaits
from results.timing.run_timing import RunTiming, percentiles, run_timing


def timed(folder: Path, *cycles: Iterable[Delivery], plan: RunPlan = PLAN) -> RunTiming:
    with RunReader(recorded(folder, *cycles, plan=plan)) as reader:
        return run_timing(reader)


def row(found: RunTiming, measure: str, of: str) -> tuple[int, float, float]:
    """Count, least and greatest [ms] of a row."""
    table = percentiles(found.durations)
    one = table[(table.measure == measure) & (table.of == of)].iloc[0]
    return one["count"], one.min_us / 1e3, one.max_us / 1e3


def process(found: RunTiming, agent: str) -> pd.Series:
    return found.processes.set_index("agent").T[agent]


def test_each_measure_goes_from_where_to_where_it_is_defined(tmp_path: Path) -> None:
    found = timed(tmp_path, cycle(0), cycle(1))
    assert len(found.loop_ms) == 2
    assert row(found, "loop", "all commands") == (2, 13.6, 13.6)
    assert row(found, "loop", "each command") == (8, 13.0, 13.4)
    assert row(found, "decision", "plant sense") == (2, 1.3, 1.3)
    # c1/a says at 4.15 ms that it needs help: its last message counts.
    assert row(found, "decision", "direct estimate") == (8, 2.15, 6.9)
    assert row(found, "decision", "central solve") == (2, 1.1, 1.1)
    assert row(found, "decision", "plant apply") == (2, 0.4, 0.4)
    assert row(found, "hop", "telemetry") == (8, 1.0, 1.0)
    # To c1 0.3, to c2 0.5 and to the central controller 0.4 ms.
    assert row(found, "hop", "residual") == (6, 0.3, 0.5)
    assert row(found, "hop", "setpoint") == (12, 0.3, 0.4)
    assert row(found, "hop", "command") == (2, 0.2, 0.2)
    assert row(found, "lateness", "plant sense") == (2, 0.9, 0.9)
    # The dispatch is the oldest input of all stages but the plant's.
    assert row(found, "age", "supervisor solve") == (4, 10.9, 11.0)
    assert row(found, "age", "plant apply") == (2, 0.6, 0.6)


def test_a_missed_deadline_is_a_stage_that_names_an_input_it_awaited(tmp_path: Path) -> None:
    deadline_ms = PLAN.deadlines.deadline_ns("plant", "apply") / MS
    late = {**without("c2/d/command"), "production": (deadline_ms, deadline_ms + 0.5)}
    gone = {"production": ("c2/d/command@0",)}
    found = timed(tmp_path, cycle(0), cycle(1, late, gone))
    plant = process(found, "plant")
    assert (plant.missed_deadlines, plant.missing_inputs, plant.overruns) == (1, 1, 0)
    # The loop lasts up to the deadline, and the plant kept it to half a millisecond.
    assert row(found, "loop", "all commands")[2] == pytest.approx(deadline_ms)
    assert row(found, "lateness", "plant apply") == (1, 0.5, 0.5)
    # The hop of a command that did not come is none; its old one is as old as it is.
    assert row(found, "hop", "command")[0] == 1
    age_ms = CYCLE_MS + deadline_ms - 13.4
    assert row(found, "age", "plant apply")[2] == pytest.approx(age_ms)


def test_an_input_that_comes_while_its_receiver_is_busy_has_no_hop(tmp_path: Path) -> None:
    slow = {**TIMES_MS, "c1/a/command": (12.4, CYCLE_MS + 2.5)}
    found = timed(tmp_path, cycle(0, slow), cycle(1))
    assert row(found, "hop", "telemetry")[0] == 7


@pytest.mark.parametrize(
    ("key", "latest_ns", "agent"),
    [
        ("c2/c/residual", PLAN.deadlines.deadline_ns("c2/c", "estimate"), "c2/c"),
        # The plant overruns its tick if it takes its whole part of the cycle.
        ("c2/d/telemetry", PLAN.deadlines.slice_ns("plant", "sense"), "plant"),
    ],
)
def test_an_overrun_is_a_stage_that_had_all_and_spoke_after_its_deadline(
    key: str, latest_ns: int, agent: str, tmp_path: Path
) -> None:
    slow = {**TIMES_MS, key: (TIMES_MS[key][0], latest_ns / MS + 0.001)}
    found = timed(tmp_path, cycle(0), cycle(1, slow))
    assert found.processes.set_index("agent").overruns.loc[lambda n: n > 0].to_dict() == {agent: 1}
    assert found.late_cycles == 1


def test_a_cycle_in_which_an_agent_said_nothing_was_skipped(tmp_path: Path) -> None:
    silent = without("c2/c/impp", "c2/c/residual", "c2/c/command")
    half = without("c1/a/command")
    found = timed(tmp_path, cycle(0), cycle(1, silent), cycle(2, half))
    skipped = found.processes.set_index("agent").skipped_cycles
    assert skipped[skipped > 0].to_dict() == {"c2/c": 1}
    assert found.late_cycles == 1


def test_what_comes_after_the_plants_last_cycle_does_not_count(tmp_path: Path) -> None:
    cut = {key: times for key, times in TIMES_MS.items() if times[1] < 4.0}
    found = timed(tmp_path, cycle(0), cycle(1, cut))
    assert len(found.loop_ms) == 1
    assert row(found, "decision", "plant sense")[0] == 1
    assert not found.processes.skipped_cycles.any()


def test_of_a_message_that_came_twice_the_first_counts(tmp_path: Path) -> None:
    again = list(cycle(0, {"production": (13.6, 50.0)}))
    found = timed(tmp_path, cycle(0), again)
    assert row(found, "decision", "plant apply") == (1, 0.4, 0.4)


def test_between_its_parents_turns_a_setpoint_of_the_last_turn_is_due(tmp_path: Path) -> None:
    plan = with_changes(PLAN, period_cycles=(2, 1))
    between = without("c1/setpoint", "c2/setpoint")
    found = timed(tmp_path, cycle(0), cycle(1, between), plan=plan)
    assert not process(found, "c1").missed_deadlines
    # In cycle 1 it is the oldest input of the supervisors' solve.
    age_ms = CYCLE_MS + TIMES_MS["c1/a/setpoint"][0] - TIMES_MS["c1/setpoint"][1]
    assert row(found, "age", "supervisor solve")[2] == pytest.approx(age_ms)


def test_a_device_is_seen_from_outside_and_counts_nothing(tmp_path: Path) -> None:
    plan = with_changes(PLAN, external=("c2/d",))
    unknown = {key: (0.0, times[1]) for key, times in TIMES_MS.items() if key.startswith("c2/d/")}
    found = timed(tmp_path, cycle(0, {**TIMES_MS, **unknown}), plan=plan)
    assert "c2/d" not in found.processes.agent.tolist()
    assert row(found, "decision", "direct estimate")[0] == 3
    # From the telemetry, published at 1.3 ms, to its own last message at 4.5 ms.
    assert row(found, "response", "c2/d estimate") == (1, 3.2, 3.2)
    assert row(found, "hop", "command of c2/d") == (1, 0.2, 0.2)


@pytest.mark.parametrize("publish_ms", [-START_NS / MS, -150.0])
def test_a_publish_time_that_is_unknown_or_impossible_is_in_no_row(
    publish_ms: float, tmp_path: Path
) -> None:
    plan = with_changes(PLAN, external=("c2/d",))
    late = {**TIMES_MS, "c2/d/command": (0.0, publish_ms)}
    found = timed(tmp_path, cycle(0, late), plan=plan)
    assert row(found, "loop", "each command")[0] == 3
    assert found.durations.of[found.durations.measure == "response"].tolist() == ["c2/d estimate"]


def test_of_an_external_plant_the_loop_is_seen_from_outside_while_our_inverters_answer(
    tmp_path: Path,
) -> None:
    plan = with_changes(PLAN, external=("plant",))
    alone = {key: times for key, times in TIMES_MS.items() if times[0] == 0.0}
    alone["production"] = (13.6, 90.0)
    found = timed(tmp_path, cycle(0), cycle(1, alone), plan=plan)
    assert row(found, "loop", "all commands") == (1, 14.0, 14.0)


@pytest.mark.parametrize(("wall_ns", "driver"), [(0, "launch"), (CYCLE_MS * MS, "simulate")])
def test_a_run_that_was_not_in_real_time_is_refused(
    wall_ns: int, driver: str, tmp_path: Path
) -> None:
    folder = recorded(
        tmp_path, cycle(0), plan=with_changes(PLAN, cycle_wall_ns=wall_ns), driver=driver
    )
    with RunReader(folder) as reader, pytest.raises(InputError, match="real time"):
        run_timing(reader)


def test_a_start_that_is_far_from_its_message_is_not_believed(tmp_path: Path) -> None:
    far = replace(PLAN.run_message("start", 0, START_NS + 3_600_000 * MS), publish_time_ns=START_NS)
    with RunReader(recorded(tmp_path, cycle(0), start=far)) as reader:
        found = run_timing(reader)
    assert row(found, "loop", "all commands") == (1, 13.6, 13.6)


@pytest.mark.parametrize(
    ("count", "p50_us", "p99_us", "p99_9_us"), [(10, 5, 10, 10), (1000, 500, 990, 999)]
)
def test_percentiles_are_durations_that_so_many_do_not_exceed(
    count: int, p50_us: int, p99_us: int, p99_9_us: int
) -> None:
    us = np.arange(1, count + 1)
    (found,) = percentiles(
        pd.DataFrame({"measure": "hop", "of": "impp", "us": us, "count": 1})
    ).to_dict("records")
    assert (found["count"], found["min_us"], found["max_us"]) == (count, 1, count)
    assert (found["p50_us"], found["p99_us"], found["p99_9_us"]) == (p50_us, p99_us, p99_9_us)


def test_a_hop_between_the_clocks_of_two_hosts_is_not_measured(tmp_path: Path) -> None:
    away = with_changes(PLAN, addresses=dict.fromkeys(("c2", "c2/c", "c2/d"), "10.0.0.2"))
    found = timed(tmp_path, cycle(0), plan=away)
    # Plant and central controller await what comes from there, c2 what comes from here.
    assert row(found, "hop", "setpoint")[0] == 5
    assert row(found, "hop", "residual")[0] == 1
    assert "command" not in found.durations.of.tolist()


# Blocks of cycles ---------------------------------------------------------------------------------


def test_a_run_read_in_blocks_measures_what_it_measures_as_a_whole(tmp_path: Path) -> None:
    plan = with_changes(PLAN, period_cycles=(3, 1))
    between = without("c1/setpoint", "c2/setpoint")
    slow = {**between, "c1/a/command": (12.4, CYCLE_MS + 2.5), "production": (13.6, 31.0)}
    cycles = [cycle(k, TIMES_MS if k % 3 == 0 else (slow, between)[k % 2]) for k in range(9)]
    with RunReader(recorded(tmp_path, *cycles, plan=plan)) as reader:
        whole, parts = run_timing(reader), run_timing(reader, block_messages=1)
    pd.testing.assert_frame_equal(parts.durations, whole.durations)
    pd.testing.assert_frame_equal(parts.processes, whole.processes)
    pd.testing.assert_series_equal(parts.loop_ms, whole.loop_ms)
    assert parts.late_cycles == whole.late_cycles > 0
    assert [one.in_words() for one in parts.slowest] == [one.in_words() for one in whole.slowest]


def test_memory_does_not_grow_with_the_length_of_a_run(tmp_path: Path) -> None:
    peaks = []
    for length in (20, 120):
        (folder := tmp_path / str(length)).mkdir()
        with RunReader(recorded(folder, *map(cycle, range(length)))) as reader:
            tracemalloc.start()
            run_timing(reader, block_messages=1_000)
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    assert peaks[1] < 2 * peaks[0], "read as a whole, it takes three times as much"


# Who waited for whom ------------------------------------------------------------------------------


def links(found: CycleWaits) -> list[tuple[str, str, float, float]]:
    rows = found.chain[["agent", "name", "began_ms", "ended_ms"]].round(6)
    return [tuple(row) for row in rows.itertuples(index=False)]


def test_the_chain_leads_from_the_tick_through_whoever_was_waited_for(tmp_path: Path) -> None:
    (found,) = timed(tmp_path, cycle(0)).slowest
    assert links(found) == [
        ("plant", "sense", 0.0, 1.2),
        ("c2/c", "estimate", 1.2, 9.1),
        ("c2", "report", 9.1, 10.1),
        ("central", "solve", 10.1, 11.6),
        ("c2", "solve", 11.6, 12.3),
        ("c2/d", "actuate", 12.3, 13.4),
        ("plant", "apply", 13.4, 14.0),
    ]
    assert found.in_words() == "cycle 0: 14.0 ms, c2/c took 7.9 ms (estimate)"


def test_the_slowest_cycles_come_slowest_first(tmp_path: Path) -> None:
    lengths_ms = (14.0, 31.0, 17.0, 40.0, 16.0)
    cycles = [
        cycle(number, {**TIMES_MS, "production": (13.6, length_ms)})
        for number, length_ms in enumerate(lengths_ms)
    ]
    assert [waits.cycle for waits in timed(tmp_path, *cycles).slowest] == [3, 1, 2]


@pytest.mark.parametrize("comes", [True, False])
def test_a_stage_that_closed_at_its_deadline_waited_for_what_came_too_late(
    comes: bool, tmp_path: Path
) -> None:
    deadline_ms = PLAN.deadlines.deadline_ns("plant", "apply") / MS
    late = {**TIMES_MS, "production": (deadline_ms, deadline_ms + 0.2)}
    late["c2/d/command"] = (12.7, deadline_ms + 5.0)
    if not comes:
        del late["c2/d/command"]
    (found,) = timed(tmp_path, cycle(0, late, {"production": ("c2/d/command",)})).slowest
    assert "without c2/d/command" in found.chain.text.iloc[-1]
    if comes:  # Its link ends when nobody waited for it any more.
        assert links(found)[-2][:2] == ("c2/d", "actuate")
        assert links(found)[-2][3] == links(found)[-1][3] == pytest.approx(deadline_ms + 0.2)
        assert "c2/d took" in found.in_words()
    else:  # The chain begins where what was missing never came.
        assert [link[:3] for link in links(found)] == [("plant", "apply", 0.0)]


def test_a_stage_that_awaits_nothing_follows_the_one_before_it(tmp_path: Path) -> None:
    plan = with_changes(PLAN, period_cycles=(2, 1))
    slow = {**without("c1/setpoint", "c2/setpoint"), "production": (13.6, 20.0)}
    found = timed(tmp_path, cycle(0), cycle(1, slow), plan=plan).slowest[0]
    assert [link[:2] for link in links(found)] == [
        ("plant", "sense"),
        ("c2/c", "estimate"),
        ("c2", "report"),
        ("c2", "solve"),
        ("c2/d", "actuate"),
        ("plant", "apply"),
    ]
