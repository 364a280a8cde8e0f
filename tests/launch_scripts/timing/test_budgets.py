"""Budgets follow the cycle, or the scenario; each line of them is kept or not."""

from __future__ import annotations

import msgspec
import pytest
from msgspec.structs import replace
from timings_by_hand import REAL_TIME, TIMINGS, TREE, account, report, timing

from bus_schemas.signals import SIGNALS, Occurrence
from launch_scripts.summary import ProcessAccount
from launch_scripts.timing.budget_table import BudgetTable, TimingTable
from launch_scripts.timing.budgets import Verdict, budgets_of, judge
from launch_scripts.timing.measures import tier_accounts, times_by_tier

SUPERVISORS = ("request", "report", "solve")


def verdicts(table: BudgetTable, *, lost: int = 0) -> dict[str, Verdict]:
    return {verdict.line: verdict for verdict in report(table=table, lost=lost).verdicts}


def test_default_budgets_follow_the_length_of_the_cycle() -> None:
    fast = budgets_of(REAL_TIME, BudgetTable())  # 80 ms, of which a tier has 9
    assert fast.loop_p99_ms == pytest.approx(40.0)
    assert fast.times_p99_ms["decision"]["direct actuate"] == pytest.approx(9.0)
    assert fast.times_p99_ms["lateness"] == {"plant": pytest.approx(1.6)}
    slow = budgets_of(replace(REAL_TIME, cycle_wall_ns=800_000_000_000), BudgetTable())
    # 90 s for each stage: the paper's upper bounds are nearer.
    assert slow.times_p99_ms["decision"] == {
        "plant": pytest.approx(90_000),
        "plant begin": pytest.approx(90_000),
        "plant advance": pytest.approx(90_000),
        **dict.fromkeys(("central", "central request", "central solve"), 60_000),
        **dict.fromkeys(("supervisor", *(f"supervisor {s}" for s in SUPERVISORS)), 10_000),
        **dict.fromkeys(("direct", "direct estimate", "direct actuate"), 1_000),
    }


def test_budgets_of_decisions_follow_the_deadlines_of_the_tiers() -> None:
    plan = replace(REAL_TIME, tier_deadlines_ns=(5_000_000, 50_000_000, 60_000_000))
    decision = budgets_of(plan, BudgetTable()).times_p99_ms["decision"]
    # Five stages share the 5 ms up to the central controller's last word; cycles last 80 ms.
    assert decision["direct estimate"] == decision["central solve"] == pytest.approx(1.0)
    assert decision["supervisor solve"] == pytest.approx(45.0)
    assert decision["direct actuate"] == decision["plant advance"] == pytest.approx(10.0)
    stated = BudgetTable(decision_p99_ms={"direct": 3.0})
    decision = budgets_of(plan, stated).times_p99_ms["decision"]
    assert decision["direct estimate"] == decision["direct actuate"] == 3.0
    times = times_by_tier(TIMINGS, TREE)
    found = {verdict.line: verdict for verdict in judge(budgets_of(plan, stated), times, (), 0, ())}
    # 0.5 ms of 1, 6 ms of 3, 1.5 ms of 1.
    assert found["decision supervisor report p99"].passed
    assert not found["decision direct estimate p99"].passed
    assert not found["decision central solve p99"].passed


def test_a_devices_response_has_the_budget_of_its_own_stage() -> None:
    tiers_ns = (5_000_000, 50_000_000, 60_000_000)
    plan = replace(REAL_TIME, tier_deadlines_ns=tiers_ns, external=("c2/d",))
    response = budgets_of(plan, BudgetTable()).times_p99_ms["response"]
    assert response["c2/d estimate"] == pytest.approx(1.0)
    assert response["c2/d actuate"] == pytest.approx(10.0)


def test_the_recorder_may_not_take_a_whole_core_either() -> None:
    recorder = ProcessAccount("recorder", "recorder", {}, 50.0, cpu_percent=85.0)
    tiers = tier_accounts([recorder], TREE)

    def failed(table: BudgetTable) -> set[str]:
        found = judge(budgets_of(REAL_TIME, table), (), tiers, 0, ())
        return {verdict.line for verdict in found if not verdict.passed}

    assert failed(BudgetTable()) == {"CPU of a recorder"}
    own = {"cpu_percent": {"recorder": 90.0}, "resident_mb": {"recorder": 45.0}}
    table = msgspec.convert({"budgets": own}, TimingTable).stated
    assert failed(table) == {"memory of a recorder"}


def test_cycles_that_were_given_up_are_not_kept() -> None:
    accounts = [replace(account(found), cycles_given_up=2) for found in TIMINGS[:2]]
    tiers = tier_accounts(accounts, TREE)

    def failed(table: BudgetTable) -> set[str]:
        found = judge(budgets_of(REAL_TIME, table), (), tiers, 0, ())
        return {verdict.line for verdict in found if not verdict.passed}

    assert failed(BudgetTable()) == {"cycles given up"}
    assert failed(BudgetTable(cycles_given_up=4)) == set()


def test_every_signal_that_somebody_waits_for_has_a_budget() -> None:
    cyclic = {Occurrence.CYCLE, Occurrence.TURN, Occurrence.NEED}
    for signal in SIGNALS:
        waited_for = bool(signal.listeners) and signal.occurrence in cyclic
        assert (signal.hop_p99_ms is not None) == waited_for, signal.name


def test_a_budget_of_the_scenario_takes_the_place_of_the_default() -> None:
    default = verdicts(BudgetTable())
    assert all(verdict.passed for verdict in default.values())
    strict = verdicts(
        BudgetTable(
            loop_p99_ms=25.0,
            loop_max_ms=29.0,
            hop_p99_ms={"impp": 3.5},
            decision_p99_ms={"direct": 5.5},
            age_p99_ms={"direct": 7.5},
            cpu_percent={"direct": 25.0},
            resident_mb={"central": 39.0},
        )
    )
    assert {line for line, verdict in strict.items() if not verdict.passed} == {
        "loop all commands p99",
        "loop all commands max",
        "hop impp p99",
        "decision direct estimate p99",
        "CPU of a direct",
        "memory of a central",
    }
    assert strict["age direct estimate p99"].passed
    assert strict["hop impp p99"].value == pytest.approx(4.0, rel=0.01)
    assert strict["hop impp p99"].limit == 3.5


def test_deadlines_overruns_and_losses_are_counted_over_all_tiers() -> None:
    timings = (*TIMINGS[:-1], timing("c2/d", {}, missed=2, overruns=3))
    accounts = [account(found, dropped=1) for found in timings]
    tiers, times = tier_accounts(accounts, TREE), times_by_tier(timings, TREE)

    def failed(table: BudgetTable, lost: int) -> set[str]:
        found = judge(budgets_of(REAL_TIME, table), times, tiers, lost, set())
        return {verdict.line for verdict in found if not verdict.passed}

    assert failed(BudgetTable(), 4) == {
        "missed deadlines",
        "overruns",
        "messages not recorded",
    }
    lenient = BudgetTable(missed_deadlines=2, overruns=3, lost_messages=4, dropped_messages=5)
    assert failed(lenient, 4) == set()
    assert failed(replace(lenient, dropped_messages=4), 4) == {"dropped messages"}


def test_what_was_not_measured_although_it_must_be_is_not_kept() -> None:
    times = times_by_tier(TIMINGS, TREE)
    expected = {("hop", "request"), ("hop", "impp"), ("loop", "all commands"), ("decision", "x")}
    found = judge(budgets_of(REAL_TIME, BudgetTable()), times, (), 0, expected)
    absent = [verdict for verdict in found if verdict.value is None]
    assert [(verdict.line, verdict.passed) for verdict in absent] == [("hop request p99", False)]
    nothing = judge(budgets_of(REAL_TIME, BudgetTable()), (), (), 0, expected)
    assert {verdict.line for verdict in nothing if verdict.value is None} == {
        "hop request p99",
        "hop impp p99",
        "loop all commands p99",
    }


def test_a_table_of_a_scenario_is_read_with_its_types() -> None:
    text = "[budgets]\nloop_p99_ms = 25\nhop_p99_ms = { impp = 5.5 }\nmissed_deadlines = 3\n"
    table = msgspec.toml.decode(text, type=TimingTable).stated
    assert (table.loop_p99_ms, table.hop_p99_ms, table.missed_deadlines) == (25, {"impp": 5.5}, 3)
    assert TimingTable().stated == BudgetTable()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("foo = 3", "budgets.foo: no such budget, accepted are age_p99_ms, cpu_percent, cycles_"),
        ("hop_p99_ms = { foo = 3 }", "budgets.hop_p99_ms.foo: accepted are telemetry, dispatch"),
        ("hop_p99_ms = { production = 3 }", "budgets.hop_p99_ms.production: accepted are tele"),
        ("decision_p99_ms = { recorder = 3 }", "accepted are plant, central, supervisor, direct"),
        ("hop_p99_ms = 3", "is 3, accepted is a table such as { telemetry = 5 }"),
        ("loop_p99_ms = 0", "budgets.loop_p99_ms is 0, accepted is a number above 0"),
        (
            "hop_p99_ms = { impp = 0.0 }",
            "budgets.hop_p99_ms.impp is 0.0, accepted is a number above 0",
        ),
        ("loop_p99_ms = -1", "budgets.loop_p99_ms is -1, accepted is a number above 0"),
        ("loop_p99_ms = nan", "budgets.loop_p99_ms is nan"),
        ("loop_p99_ms = inf", "budgets.loop_p99_ms is inf"),
        ("loop_p99_ms = true", "budgets.loop_p99_ms is True"),
        ('loop_p99_ms = "fast"', "budgets.loop_p99_ms is 'fast', accepted is a number"),
        ("missed_deadlines = 1.5", "missed_deadlines is 1.5, accepted is a whole number"),
    ],
)
def test_a_budget_that_makes_no_sense_is_refused(line: str, words: str) -> None:
    with pytest.raises(msgspec.ValidationError) as refusal:
        msgspec.toml.decode(f"[budgets]\n{line}\n", type=TimingTable)
    assert words in str(refusal.value)
