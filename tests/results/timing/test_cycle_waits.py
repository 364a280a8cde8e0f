"""Who waited for whom in a cycle: found from the publish times of recordings made by hand."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from plans_by_hand import with_changes
from timed_recordings import MS, PLAN, TIMES_MS, cycle, recorded, without

from bus_schemas.bus import Delivery
from recordings.read.reader import RunReader
from results.timing.cycle_waits import CycleWaits
from results.timing.run_timing import SLOWEST, run_timing


def slowest(folder: Path, *cycles: Iterable[Delivery]) -> tuple[CycleWaits, ...]:
    with RunReader(recorded(folder, *cycles)) as reader:
        return run_timing(reader).slowest


def ms(time_ns: int) -> float:
    return round(time_ns / MS, 6)


def links(found: CycleWaits) -> list[tuple[str, str, float, float]]:
    return [(w.agent, w.stage, ms(w.began_ns), ms(w.ended_ns)) for w in found.chain]


def test_the_chain_leads_from_the_tick_through_whoever_was_waited_for(tmp_path: Path) -> None:
    (found,) = slowest(tmp_path, cycle(0))
    assert links(found) == [
        ("plant", "sense", 0.0, 1.2),
        ("c2/c", "estimate", 1.2, 9.1),
        ("c2", "report", 9.1, 10.1),
        ("central", "solve", 10.1, 11.6),
        ("c2", "solve", 11.6, 12.3),
        ("c2/d", "actuate", 12.3, 13.4),
        ("plant", "apply", 13.4, 14.0),
    ]
    assert found.slowest.agent == "c2/c"
    assert ms(found.loop_ns) == 14.0


def test_the_slowest_cycles_come_slowest_first(tmp_path: Path) -> None:
    lengths_ms = (14.0, 31.0, 17.0, 40.0, 16.0)
    cycles = [
        cycle(number, {**TIMES_MS, "production": (13.6, length_ms)})
        for number, length_ms in enumerate(lengths_ms)
    ]
    found = slowest(tmp_path, *cycles)
    assert [waits.cycle for waits in found] == [3, 1, 2]
    assert len(found) == SLOWEST


def test_where_a_stage_closed_at_its_deadline_who_came_too_late_is_the_cause(
    tmp_path: Path,
) -> None:
    deadline_ms = PLAN.deadlines.deadline_ns("plant", "apply") / MS
    late = {
        **TIMES_MS,
        "c2/d/command": (12.7, deadline_ms + 5.0),
        "production": (deadline_ms, deadline_ms + 0.2),
    }
    (found,) = slowest(tmp_path, cycle(0, late, {"production": ("c2/d/command",)}))
    *_, command, apply = links(found)
    # Its link ends when nobody waited for it any more.
    assert command[:2] == ("c2/d", "actuate")
    assert command[3] == apply[3] == ms(round((deadline_ms + 0.2) * MS))
    assert found.chain[-1].without == ("c2/d/command",)
    assert found.slowest.agent == "c2/d"


def test_where_what_was_missing_never_came_the_chain_begins_there(tmp_path: Path) -> None:
    deadline_ms = PLAN.deadlines.deadline_ns("plant", "apply") / MS
    late = {**without("c2/d/command"), "production": (deadline_ms, deadline_ms + 0.2)}
    (found,) = slowest(tmp_path, cycle(0, late, {"production": ("c2/d/command",)}))
    (only,) = found.chain
    assert (only.agent, only.cause, only.began_ns) == ("plant", None, 0)


def test_a_stage_that_awaits_nothing_follows_the_one_before_it(tmp_path: Path) -> None:
    plan = with_changes(PLAN, period_cycles=(2, 1))
    between = without("c1/setpoint", "c2/setpoint")
    slow = {**between, "production": (13.6, 20.0)}
    with RunReader(recorded(tmp_path, cycle(0), cycle(1, slow), plan=plan)) as reader:
        found = run_timing(reader).slowest[0]
    assert [(wait.agent, wait.stage) for wait in found.chain] == [
        ("plant", "sense"),
        ("c2/c", "estimate"),
        ("c2", "report"),
        ("c2", "solve"),
        ("c2/d", "actuate"),
        ("plant", "apply"),
    ]
