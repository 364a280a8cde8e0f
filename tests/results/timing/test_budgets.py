"""Budgets follow the cycle, or the scenario; each line of them is kept or not."""

from __future__ import annotations

from pathlib import Path

import pytest
from plans_by_hand import with_changes
from reports_by_hand import MISSED, missed, reported
from timed_recordings import PLAN, TIMES_MS, cycle

from results.timing.budgets import p99_limits_ms
from results.timing.report import TimingReport
from scenarios.scenario import BudgetTable

TIERED = with_changes(PLAN, tier_deadlines_ns=(6_000_000, 50_000_000, 60_000_000))


def failed(report: TimingReport) -> set[str]:
    return {verdict.line for verdict in report.verdicts if not verdict.passed}


def test_default_budgets_follow_the_length_of_the_cycle() -> None:
    fast = p99_limits_ms(PLAN, BudgetTable())  # 100 ms: 33.75 for the first stage, 11.25 each.
    assert fast["loop"] == {"all commands": pytest.approx(50.0)}
    assert fast["decision"]["direct actuate"] == pytest.approx(11.25)
    assert fast["lateness"] == {"plant": pytest.approx(2.0)}
    slow = p99_limits_ms(with_changes(PLAN, cycle_wall_ns=800_000_000_000), BudgetTable())
    # 90 s for each stage: the paper's upper bounds are nearer.
    decision = slow["decision"]
    assert decision["plant apply"] == pytest.approx(90_000)
    assert decision["central solve"] == 60_000
    assert decision["supervisor report"] == decision["supervisor solve"] == 10_000
    assert decision["direct estimate"] == decision["direct actuate"] == 1_000


def test_budgets_of_decisions_follow_the_deadlines_of_the_tiers() -> None:
    # Three stages share the 6 ms up to the central controller's last message, the first has three
    # parts; cycles last 100 ms.
    expected = {
        "direct estimate": 3.6,
        "central solve": 1.2,
        "supervisor solve": 44.0,
        "direct actuate": 10.0,
        "plant apply": 20.0,
    }
    decision = p99_limits_ms(TIERED, BudgetTable())["decision"]
    assert {row: decision[row] for row in expected} == pytest.approx(expected)
    stated = p99_limits_ms(TIERED, BudgetTable(decision_p99_ms={"direct": 3.0}))
    assert stated["decision"]["direct estimate"] == 3.0
    # The response of a device has the budget of its own stage.
    response = p99_limits_ms(with_changes(TIERED, external=("c2/d",)), BudgetTable())["response"]
    assert response == pytest.approx({"c2/d estimate": 3.6, "c2/d actuate": 10.0})


def test_a_budget_of_the_scenario_takes_the_place_of_the_default(tmp_path: Path) -> None:
    budgets = """
        loop_p99_ms = 13
        loop_max_ms = 13.5
        hop_p99_ms = { residual = 0.45, setpoint = 1 }
        decision_p99_ms = { direct = 5.5 }
        age_p99_ms = { supervisor = 20 }
        cpu_percent = { direct = 5 }
        resident_mb = { central = 39, plant = 41 }
    """
    report = reported(tmp_path, budgets=budgets)
    assert failed(report) == {
        "loop all commands p99",
        "loop all commands max",
        "hop residual p99",
        "decision direct estimate p99",
        "CPU of a direct",
        "memory of a central",
    }
    (verdict,) = [entry for entry in report.verdicts if entry.line == "hop residual p99"]
    assert (verdict.value, verdict.limit) == (0.5, 0.45)


def test_missed_deadlines_overruns_skipped_cycles_and_losses_are_counted(tmp_path: Path) -> None:
    silent = {key: times for key, times in MISSED.items() if key[:4] != "c2/d"}
    slow = {**TIMES_MS, "c1/a/help": (2.0, 34.0)}
    cycles = [
        list(cycle(0)),
        list(missed(1)),
        list(cycle(2, silent, {"production": ("c2/d/command",)})),
        list(cycle(3, slow)),
    ]
    kept = "overruns = 1\nskipped_cycles = 1\nmissed_deadlines = 2\nlost_messages = 4"
    strict = reported(tmp_path / "strict", *cycles, lost=4, dropped=1)
    counts = {"missed deadlines", "overruns", "skipped cycles", "messages not recorded"}
    assert failed(strict) & {*counts, "dropped messages"} == counts
    lenient = reported(tmp_path / "lenient", *cycles, lost=4, dropped=1, budgets=kept)
    assert not failed(lenient) & counts
    dropped = reported(tmp_path / "dropped", dropped=1, budgets="dropped_messages = 8")
    assert failed(dropped) == {"dropped messages"}


def test_what_was_not_measured_although_it_must_be_is_not_kept(tmp_path: Path) -> None:
    # The commands never complete the plant's stage, and a device tells no time of its own.
    plan = with_changes(PLAN, external=("c1/a",))
    estimates = ("c1/a/impp", "c1/a/residual", "c1/a/help")
    late = {key: (0.0, -5_000.0) if key in estimates else MISSED[key] for key in MISSED}
    lack = {"production": ("c2/d/command",)}
    stated = "hop_p99_ms = { command = 10 }"
    report = reported(tmp_path, cycle(0, late, lack), plan=plan, budgets=stated)
    absent = {verdict.line for verdict in report.verdicts if verdict.value is None}
    assert absent == {"hop command p99", "response c1/a estimate p99"}
    assert absent <= failed(report)
