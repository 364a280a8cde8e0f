"""The tidy table of stages, and the figures that are groupbys on it."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace
from plans_by_hand import with_changes
from timed_recordings import (
    CYCLE_MS,
    MS,
    PLAN,
    START_NS,
    TIMES_MS,
    cycle,
    recorded,
    recorded_at,
    without,
)

from agents.plan import RunPlan
from agents.process.machine_watch import MachineStop
from bus_schemas.bus import Delivery
from bus_schemas.errors import InputError
from recordings.read.reader import RunReader
from results.timing.late_cycles import LateCycle
from results.timing.report import TimingReport, report_on
from results.timing.stages import stage_table


def timed(
    folder: Path, *cycles: Iterable[Delivery], plan: RunPlan = PLAN, **words: Any
) -> TimingReport:
    return report_on(recorded(folder, *cycles, plan=plan, **words))


def row(found: TimingReport, measure: str, of: str, by: str = "tier") -> tuple[int, float, float]:
    """Count, least and greatest [ms] of a row."""
    table = found.times
    one = table[(table.by == by) & (table.measure == measure) & (table.of == of)].iloc[0]
    return one["count"], round(one.min_ms, 6), round(one.max_ms, 6)


def late_rows(found: TimingReport) -> set[tuple[int, str, str, str]]:
    rows = found.stages[found.stages.late != ""]
    names = ["cycle", "agent", "stage", "late"]
    return {tuple(one) for one in rows[names].itertuples(index=False)}


def test_each_measure_goes_from_where_to_where_it_is_defined(tmp_path: Path) -> None:
    found = timed(tmp_path, cycle(0), cycle(1))
    assert len(found.loop_ms) == 2
    assert row(found, "loop", "all commands") == (2, 13.6, 13.6)
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
    assert row(found, "gap sent", "direct") == row(found, "gap received", "direct") == (4, 100, 100)
    assert row(found, "decision", "c2/c estimate", "agent") == (2, 6.9, 6.9)
    assert row(found, "hop", "residual to c2", "agent") == (2, 0.5, 0.5)
    assert row(found, "hop", "c2/residual to central", "link") == (2, 0.4, 0.4)


def test_a_missed_deadline_is_a_stage_that_names_an_input_it_awaited(tmp_path: Path) -> None:
    deadline_ms = PLAN.deadlines.deadline_ns("plant", "apply") / MS
    late = {**without("c2/d/command"), "production": (deadline_ms, deadline_ms + 0.5)}
    gone = {"production": ("c2/d/command@0",)}
    found = timed(tmp_path, cycle(0), cycle(1, late, gone))
    assert late_rows(found) == {(1, "plant", "apply", "without")}
    plant = found.tiers.set_index("tier").loc["plant"]
    assert (plant.missed_deadlines, plant.overruns) == (1, 0)
    # The loop lasts up to the deadline, and the plant kept it to half a millisecond.
    assert row(found, "loop", "all commands")[2] == pytest.approx(deadline_ms, abs=1e-5)
    assert row(found, "lateness", "plant apply") == (1, 0.5, 0.5)
    # The hop of a command that did not come is none; its old one is as old as it is.
    assert row(found, "hop", "command")[0] == 1
    age_ms = CYCLE_MS + deadline_ms - 13.4
    assert row(found, "age", "plant apply")[2] == pytest.approx(age_ms, abs=1e-5)


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
    assert {(one[0], one[1], one[3]) for one in late_rows(found)} == {(1, agent, "overrun")}
    assert found.run.late_cycles == 1
    assert found.late[0].culprit == agent


def test_a_cycle_in_which_an_agent_said_nothing_was_skipped(tmp_path: Path) -> None:
    silent = without("c2/c/impp", "c2/c/residual", "c2/c/command")
    half = without("c1/a/command")
    found = timed(tmp_path, cycle(0), cycle(1, silent), cycle(2, half))
    assert {one[:2] for one in late_rows(found)} == {(1, "c2/c")}
    assert found.tiers.set_index("tier").skipped_cycles["direct"] == 1
    assert found.run.late_cycles == 1


def test_between_its_parents_turns_a_setpoint_of_the_last_turn_is_due(tmp_path: Path) -> None:
    plan = with_changes(PLAN, period_cycles=(2, 1))
    between = without("c1/setpoint", "c2/setpoint")
    found = timed(tmp_path, cycle(0), cycle(1, between), plan=plan)
    assert not late_rows(found)
    # In cycle 1 it is the oldest input of the supervisors' solve.
    age_ms = CYCLE_MS + TIMES_MS["c1/a/setpoint"][0] - TIMES_MS["c1/setpoint"][1]
    assert row(found, "age", "supervisor solve")[2] == pytest.approx(age_ms, abs=1e-5)


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
        stage_table(reader)


def test_percentiles_are_measured_durations(tmp_path: Path) -> None:
    run = (
        cycle(k, {**TIMES_MS, "production": (13.5 + (k + 1) / 100.0, 40.0)}) for k in range(1000)
    )
    times = timed(tmp_path, *run).times
    (loop,) = times[(times.measure == "loop") & (times.by == "tier")].to_dict("records")
    found = [loop[f"{name}_ms"] for name in ("min", "p50", "p99", "p99.9", "max")]
    assert found == pytest.approx([13.51, 18.5, 23.4, 23.49, 23.5])
    assert sum(loop["histogram"]) == 1000


def test_a_hop_between_the_clocks_of_two_hosts_is_not_measured(tmp_path: Path) -> None:
    away = with_changes(PLAN, addresses=dict.fromkeys(("c2", "c2/c", "c2/d"), "10.0.0.2"))
    found = timed(tmp_path, cycle(0), plan=away)
    # Plant and central controller await what comes from there, c2 what comes from here.
    assert row(found, "hop", "setpoint")[0] == 5
    assert row(found, "hop", "residual")[0] == 2
    assert "command" not in found.times.of.tolist()
    assert (found.times.min_ms >= 0.0).all()
    (clock,) = found.clocks
    # Its setpoint came 0.3 ms, the command 0.2 ms after it was published.
    assert clock.host == "10.0.0.2"
    assert clock.offset_ms == pytest.approx(0.05)
    assert clock.uncertainty_ms == pytest.approx(0.25)


def test_the_clock_of_another_host_is_known_within_its_uncertainty(tmp_path: Path) -> None:
    ahead_ms, away = 1.7, ("c2", "c2/c", "c2/d")
    plan = with_changes(PLAN, addresses=dict.fromkeys(away, "10.0.0.2"))
    shifted = {
        key: (times[0] + ahead_ms, times[1] + ahead_ms)
        if plan.wiring.ports
        and key.rpartition("/")[0] in {"c2/c", "c2/d"}
        and key.rpartition("/")[2] in {"impp", "residual", "help", "command"}
        else times
        for key, times in TIMES_MS.items()
    }
    shifted |= {
        key: (TIMES_MS[key][0] + ahead_ms, TIMES_MS[key][1] + ahead_ms)
        for key in ("c2/impp", "c2/residual", "c2/c/setpoint", "c2/d/setpoint")
    }
    found = timed(tmp_path, cycle(0, shifted), plan=plan)
    (clock,) = found.clocks
    assert abs(clock.offset_ms - ahead_ms) <= clock.uncertainty_ms < 1.0


# The culprits of late cycles ----------------------------------------------------------------------


def culprit(folder: Path, *cycles: Iterable[Delivery], plan: RunPlan = PLAN) -> LateCycle:
    (found,) = timed(folder, *map(cycle, range(5)), *cycles, plan=plan).late
    return found


def slow_from(key: str, more_ms: float) -> dict[str, tuple[float, float]]:
    """The times of a cycle in which all that comes after the message of a key is later."""
    at_ms = TIMES_MS[key][1]
    return {
        name: (
            ready_ms + (more_ms if ready_ms > at_ms else 0.0),
            publish_ms + (more_ms if publish_ms >= at_ms else 0.0),
        )
        for name, (ready_ms, publish_ms) in TIMES_MS.items()
    }


def test_a_slow_decision_is_found_behind_all_that_waited_for_it(tmp_path: Path) -> None:
    found = culprit(tmp_path, cycle(5, slow_from("c2/c/residual", 80.0)))
    assert (found.cycle, found.culprit, found.stage, found.cause) == (
        5,
        "c2/c",
        "estimate",
        "decision",
    )
    assert found.ms == pytest.approx(86.9)
    assert found.loop_ms == pytest.approx(93.6)


def test_a_slow_hop_is_the_link(tmp_path: Path) -> None:
    times = {
        key: (ready + 80.0 * (ready >= 9.6), sent + 80.0 * (sent >= 10.0))
        for key, (ready, sent) in TIMES_MS.items()
    }
    found = culprit(tmp_path, cycle(5, times))
    assert (found.culprit, found.cause) == ("c2/c/residual to c2", "hop")
    assert found.ms == pytest.approx(80.5)


@pytest.mark.parametrize("comes", [True, False])
def test_the_chain_is_followed_through_missing_messages(comes: bool, tmp_path: Path) -> None:
    report_ms = PLAN.deadlines.deadline_ns("c2", "report") / MS
    late: dict[str, tuple[float, float]] = {
        **{key: (ready + 36.0, sent + 36.0) for key, (ready, sent) in TIMES_MS.items()},
        **{key: times for key, times in TIMES_MS.items() if times[1] < 9.0},
        "c2/impp": (report_ms, report_ms + 0.5),
        "c2/residual": (report_ms, report_ms + 0.6),
        "c2/c/impp": (2.2, report_ms + 3.0),
        "c2/c/residual": (2.2, report_ms + 3.1),
    }
    if not comes:
        del late["c2/c/impp"], late["c2/c/residual"]
    lacks = {"c2/residual": ("c2/c/residual",)}
    found = culprit(tmp_path, cycle(5, late, lacks))
    assert (found.culprit, found.stage) == ("c2/c", "estimate")
    assert found.cause == ("decision" if comes else "published nothing")
    assert (found.ms < inf) == comes
    assert "c2 closed report without c2/c/residual" in found.text


def test_a_machine_that_stood_still_is_the_cause_and_no_agent(tmp_path: Path) -> None:
    began_ns = START_NS + 5 * CYCLE_MS * MS + 5 * MS
    slow = cycle(5, slow_from("c2/c/residual", 80.0))
    folder = recorded(tmp_path, *map(cycle, range(5)), slow)
    stops = [MachineStop(began_ns, began_ns + 75 * MS)]
    (found,) = report_on(folder, stops=stops).late
    assert found.cause == "machine stood still"
    assert found.stopped_ms == pytest.approx(75.0)
    with RunReader(folder) as reader:
        stopped = stage_table(reader, stops).groupby("cycle").stopped.first()
    assert stopped.to_dict() == pytest.approx({0: 0, 1: 0, 2: 0, 3: 0, 4: 0, 5: 75.0})


# Devices ------------------------------------------------------------------------------------------


def from_device(
    number: int, *, stamped_ms: float = 0.0, late_ms: float = 0.0, silent: bool = False
) -> Iterable[tuple[Any, Any, int]]:
    """A cycle in which c2/d is a device: when it stamps, and how much later it sends."""
    limit_ms = PLAN.deadlines.deadline_ns("plant", "apply") / MS
    lacks = {"production": ("c2/d/command",)} if silent or late_ms else {}
    times = {**TIMES_MS, "production": (limit_ms, limit_ms + 0.1)} if lacks else TIMES_MS
    for port, message in cycle(number, times, lacks):
        sent_ns = message.publish_time_ns
        if port.publisher == "c2/d":
            if silent:
                continue
            sent_ns += round(late_ms * MS)
            stamp_ns = sent_ns - round(stamped_ms * MS)
            stamped = replace(message, publish_time_ns=stamp_ns, ready_time_ns=0)
            yield port, stamped, sent_ns + MS // 4
        else:
            yield port, message, sent_ns + MS // 4


def device_run(folder: Path, cycles: Iterable[Iterable[tuple[Any, Any, int]]]) -> TimingReport:
    folder.mkdir(exist_ok=True)
    plan = with_changes(PLAN, external=("c2/d",))
    recorded_at(folder, [one for cycle in cycles for one in cycle], plan)
    return report_on(folder)


def test_a_device_is_measured_from_outside(tmp_path: Path) -> None:
    found = device_run(tmp_path, (from_device(k) for k in range(20)))
    assert row(found, "decision", "direct estimate")[0] == 60, "of our own agents"
    # From the telemetry, which arrived at 1.55 ms, to its own last message at 4.75 ms.
    assert row(found, "response", "c2/d estimate") == (20, 3.2, 3.2)
    (device,) = found.external
    assert (device.late, device.silent, device.findings) == (0, 0, ())
    assert not {one.line for one in found.budgets if not one.passed} - {"messages not recorded"}


@pytest.mark.parametrize(
    ("stamped_ms", "words"),
    [(174.0, "174 ms before it sends"), (-40.0, "40 ms after it has sent")],
)
def test_a_device_that_stamps_otherwise_than_it_sends_is_named(
    stamped_ms: float, words: str, tmp_path: Path
) -> None:
    run = (from_device(k, stamped_ms=stamped_ms) for k in range(20))
    found = device_run(tmp_path, run)
    assert row(found, "response", "c2/d estimate") == (20, 3.2, 3.2), "whatever it claims"
    (text,) = found.external[0].findings
    assert words in text
    assert "c2/d/" in text
    assert "of cycle 0" in text
    assert "stamps of c2/d" in {one.line for one in found.budgets if not one.passed}


@pytest.mark.parametrize(
    ("late_ms", "silent", "counts"),
    [(50.0, False, (5, 0)), (100.0, False, (5, 0)), (200.0, False, (5, 0)), (0.0, True, (0, 10))],
)
def test_a_late_or_silent_device_is_named_with_key_and_cycle(
    late_ms: float, silent: bool, counts: tuple[int, int], tmp_path: Path
) -> None:
    bad = range(10, 15)
    run = (
        from_device(k, late_ms=late_ms * (k in bad), silent=silent and k in bad) for k in range(20)
    )
    found = device_run(tmp_path, run)
    (device,) = found.external
    assert (device.late, device.silent) == counts
    key = "c2/d/residual" if silent else "c2/d/command"
    assert f"{key} of cycle 10" in device.findings[0]
    assert "late or silent c2/d" in {one.line for one in found.budgets if not one.passed}
    assert {(one.cycle, one.culprit) for one in found.late} == {(k, "c2/d") for k in bad}
