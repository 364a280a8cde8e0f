"""What processes measured of themselves is gathered by tier, by signal and by process."""

from __future__ import annotations

import pytest
from msgspec.structs import replace
from timings_by_hand import TIMINGS, TREE, account, timing

from bus_schemas.tree import ControlTree
from launch_scripts.summary import ProcessAccount
from launch_scripts.timing.measures import (
    EVERY_COMMAND,
    WHOLE_LOOP,
    Tiers,
    tier_accounts,
    times_by_tier,
    times_of,
)


def test_durations_come_in_the_order_of_measures_and_of_a_cycle() -> None:
    assert [(row.measure, row.of) for row in times_by_tier(TIMINGS, TREE)] == [
        ("loop", WHOLE_LOOP),
        ("loop", EVERY_COMMAND),
        ("decision", "plant begin"),
        ("decision", "direct estimate"),
        ("decision", "supervisor report"),
        ("decision", "central solve"),
        ("decision", "plant advance"),
        ("hop", "impp"),
        ("hop", "command"),
        ("lateness", "plant begin"),
        ("jitter", "plant begin"),
        ("age", "direct estimate"),
    ]


def test_hops_of_a_signal_are_those_of_all_tiers_and_nodes() -> None:
    rows = {(row.measure, row.of): row for row in times_by_tier(TIMINGS, TREE)}
    impp = rows["hop", "impp"].times
    assert impp.count == 3
    assert impp.min_us == pytest.approx(1_000, rel=0.01)
    assert impp.max_us == pytest.approx(4_000, rel=0.01)
    assert rows["decision", "direct estimate"].times.count == 2
    assert rows["loop", EVERY_COMMAND].times.count == 4
    assert rows["decision", "direct estimate"].kind == "direct"


def test_a_process_has_its_own_rows_port_by_port() -> None:
    names = [(row.measure, row.of) for row in times_of(TIMINGS[0], TREE)]
    assert names[:3] == [("loop", ""), ("loop", "c1/a"), ("loop", "c2/d")]
    assert ("hop", "c1/a/command") in names
    assert ("hop", "c2/d/command") in names


def test_counts_and_shares_are_added_up_by_tier() -> None:
    accounts = [
        account(timing("c1/a", {}, missed=3, overruns=1, cpu_s=2.0), dropped=4),
        account(timing("c2/d", {}, missed=1, cpu_s=5.0), dropped=1),
        account(timing("plant", {})),
    ]
    plant, direct = tier_accounts(accounts, TREE)
    assert (plant.tier, plant.processes, plant.missed_deadlines) == ("plant", 1, 0)
    assert (direct.processes, direct.missed_deadlines, direct.overruns) == (2, 4, 1)
    assert (direct.missing_inputs, direct.late_used, direct.dropped) == (8, 4, 5)
    assert direct.cpu_percent == pytest.approx(70.0)
    assert direct.cpu_highest_percent == pytest.approx(50.0)


def test_a_process_that_measured_nothing_is_not_counted() -> None:
    silent = replace(account(timing("c1/a", {})), timing=None)
    assert tier_accounts([silent], TREE) == ()


def test_the_recorder_has_the_share_that_its_launcher_saw() -> None:
    recorder = ProcessAccount("recorder", "recorder", {}, 50.0, cpu_percent=12.5)
    _, found = tier_accounts([recorder, account(timing("c1/a", {}))], TREE)
    assert (found.tier, found.processes) == ("recorder", 1)
    assert (found.cpu_percent, found.cpu_highest_percent, found.resident_mb) == (12.5, 12.5, 50.0)
    assert (found.missed_deadlines, found.overruns, found.cycles_given_up) == (0, 0, 0)


def test_supervisors_of_several_tiers_are_told_apart() -> None:
    deep = Tiers(ControlTree((("z1/c1/a", 1.0), ("z1/c2/b", 1.0))))
    assert [deep.tier(agent) for agent in ("plant", "central", "z1", "z1/c1", "z1/c1/a")] == [
        "plant",
        "central",
        "supervisor 1",
        "supervisor 2",
        "direct",
    ]
    assert Tiers(TREE).tier("c1") == "supervisor"


def test_the_extremes_of_a_tier_are_those_of_its_processes() -> None:
    one = timing("c1/a", {"decision/estimate": [5.017, 6.0]})
    other = timing("c2/d", {"decision/estimate": [7.033]})
    (row,) = times_by_tier([one, other], TREE)
    assert (row.times.min_us, row.times.max_us) == (5_017.0, 7_033.0)


def test_where_a_process_tells_no_extremes_the_histograms_edges_hold() -> None:
    one = timing("c1/a", {"decision/estimate": [5.017, 6.0]})
    other = replace(timing("c2/d", {"decision/estimate": [7.033]}), extremes={})
    (row,) = times_by_tier([one, other], TREE)
    assert 5_017.0 / 1.01 <= row.times.min_us <= 5_017.0
    assert 7_033.0 <= row.times.max_us <= 7_033.0 * 1.01
