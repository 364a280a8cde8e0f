"""Runs in real time verify bit for bit, whatever came late, was lost, or stood still."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from msgspec.structs import replace
from troubled_runs import (
    THREE_TIERS,
    TWO_TIERS,
    TroubledRun,
    cloudy_profile,
    lockstep_run,
    plan_of,
    record,
)

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.missing import SKIPPED, absence
from launch_scripts.verification.comparison import Comparison
from launch_scripts.verification.verification import Verification, verify

CYCLE_WALL_NS = 50_000_000


def plan_in_real_time(
    ratings_kw: dict[str, float] = TWO_TIERS, period_cycles: tuple[int, ...] = (1, 1)
) -> RunPlan:
    return plan_of(ratings_kw, cycles=25, period_cycles=period_cycles, cycle_wall_ns=CYCLE_WALL_NS)


def verified(folder: Path, run: TroubledRun, said: list[Delivery]) -> Verification:
    """What the verification of all agents comes to, on a recording of what was said."""
    return verify(record(folder, run.plan, said, run.profile), (), Comparison())


def findings(found: Verification) -> dict[str, object]:
    """The first difference of each agent that has one."""
    return {name: entry.first for name, entry in found.accounts.items() if entry.first}


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    ("ratings_kw", "period_cycles"),
    [(TWO_TIERS, (1, 1)), (TWO_TIERS, (6, 2)), (THREE_TIERS, (4, 2, 1))],
)
def test_a_run_with_late_and_lost_messages_verifies_equal(
    seed: int, ratings_kw: dict[str, float], period_cycles: tuple[int, ...], tmp_path: Path
) -> None:
    plan = plan_in_real_time(ratings_kw, period_cycles)
    run = TroubledRun(plan, cloudy_profile(plan, seed), seed)
    said = run.run()
    found = verified(tmp_path / "run", run, said)
    assert findings(found) == {}
    assert found.equal
    assert found.compared == len(said) - 2, "all but the plant's start and stop"
    assert found.missed_inputs == run.missing_inputs > 20


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("ratings_kw", "period_cycles"),
    [(TWO_TIERS, (1, 1)), (TWO_TIERS, (6, 2)), (THREE_TIERS, (4, 2, 1))],
)
def test_a_run_on_a_network_that_delays_doubles_and_reorders_verifies_equal(
    seed: int, ratings_kw: dict[str, float], period_cycles: tuple[int, ...], tmp_path: Path
) -> None:
    plan = plan_in_real_time(ratings_kw, period_cycles)
    profile = cloudy_profile(plan, seed)
    run = TroubledRun(plan, profile, seed, lost=0.05, late=0.4, doubled=0.1, latest=5)
    said = run.run()
    found = verified(tmp_path / "run", run, said)
    assert findings(found) == {}
    assert found.equal
    assert found.compared == len(said) - 2
    assert found.missed_inputs == run.missing_inputs
    assert sum(account.late_used for account in found.accounts.values()) == run.late_used > 20


def test_late_words_that_a_plan_drops_are_not_used_by_the_rerun(tmp_path: Path) -> None:
    plan = replace(plan_in_real_time(), late="drop")
    run = TroubledRun(plan, cloudy_profile(plan), 1, late=0.4)
    found = verified(tmp_path / "run", run, run.run())
    assert found.equal
    assert run.late_used == 0 < run.missing_inputs == found.missed_inputs


def test_a_late_word_that_the_recording_lost_is_named(tmp_path: Path) -> None:
    plan = plan_in_real_time()
    run = TroubledRun(plan, cloudy_profile(plan), 1, lost=0.0, late=0.2)
    said = run.run()
    entry, user, cycle = next(
        (entry, message.source, message.cycle)
        for _, message in said
        for entry in message.missing
        if "impp@" in entry
    )
    used = absence(entry)
    left = [
        (port, message)
        for port, message in said
        if (str(port), message.cycle) != (used.key, used.cycle)
    ]
    assert len(left) == len(said) - 1
    found = verified(tmp_path / "run", run, left)
    first = found.accounts[user].first
    assert first is not None
    assert (first.kind, first.cycle, str(first.port)) == ("input not recorded", cycle, used.key)


@pytest.mark.parametrize("agent", ["plant", "c1/a", "c2", "central"])
@pytest.mark.parametrize("period_cycles", [(1, 1), (6, 2)])
def test_cycles_that_an_agent_gave_up_are_told_from_messages_that_are_lost(
    agent: str, period_cycles: tuple[int, ...], tmp_path: Path
) -> None:
    plan = plan_in_real_time(period_cycles=period_cycles)
    profile = cloudy_profile(plan)
    run = TroubledRun(plan, profile, 2, late=0.2, latest=3, frozen=(agent, range(8, 15)))
    said = run.run()
    assert run.skipped_cycles >= 3
    found = verified(tmp_path / "run", run, said)
    assert findings(found) == {}
    assert found.equal
    assert found.compared == len(said) - 2
    # The same recording without the word on it.
    untold = [
        (port, replace(message, missing=tuple(filter(is_input, message.missing))))
        for port, message in said
    ]
    assert not verified(tmp_path / "untold", run, untold).equal


def is_input(entry: str) -> bool:
    return not entry.startswith(SKIPPED)


def test_an_agent_that_never_came_back_leaves_nothing_undecided(tmp_path: Path) -> None:
    plan = plan_in_real_time()
    run = TroubledRun(plan, cloudy_profile(plan), 2, frozen=("c2", range(8, 99)))
    said = run.run()
    found = verified(tmp_path / "run", run, said)
    assert not found.undecided
    assert found.compared == len(said) - 2
    assert list(findings(found)) == ["c2"]


def test_without_the_word_on_what_was_missing_it_would_not(tmp_path: Path) -> None:
    plan = plan_in_real_time()
    run = TroubledRun(plan, cloudy_profile(plan), seed=1)
    said = [(port, replace(message, missing=())) for port, message in run.run()]
    found = verified(tmp_path / "run", run, said)
    assert not found.equal
    assert {"c1", "c2", "central"} <= findings(found).keys()


@pytest.mark.parametrize("agent", ["c1/a", "c2", "central"])
def test_an_agent_that_stood_still_and_caught_up_verifies_equal(agent: str, tmp_path: Path) -> None:
    plan = plan_in_real_time()
    run = TroubledRun(plan, cloudy_profile(plan), seed=2, frozen=(agent, range(8, 15)))
    said = run.run()
    cycles = {message.cycle for port, message in said if port.publisher == agent}
    assert cycles.isdisjoint(range(10, 15))
    found = verified(tmp_path / "run", run, said)
    assert findings(found) == {}
    assert found.compared == len(said) - 2


def test_an_agent_that_died_is_found_where_it_fell_silent(tmp_path: Path) -> None:
    plan = plan_in_real_time()
    run = TroubledRun(
        plan, cloudy_profile(plan), seed=2, lost=0.0, late=0.0, frozen=("c1/a", range(8, 99))
    )
    found = verified(tmp_path / "run", run, run.run())
    assert list(findings(found)) == ["c1/a"]
    account = found.accounts["c1/a"]
    assert account.first is not None
    assert (account.first.kind, account.first.cycle) == ("only new", 8)
    # What it would have had to do without from there on, nobody tells.
    assert set(account.counts) == {"only new"}
    assert account.counts["only new"] <= 4


def test_a_run_that_broke_off_anywhere_verifies_equal(tmp_path: Path) -> None:
    plan = plan_in_real_time()
    run = TroubledRun(plan, cloudy_profile(plan), seed=3, frozen=("c2/d", range(8, 15)))
    said = run.run()
    compared = set()
    for length in range(40, len(said), 17):
        found = verified(tmp_path / "run", run, said[:length])
        assert findings(found) == {}, length
        assert found.stop_cycle is None
        compared.add(length - 1 - found.compared)
    # Of a stage whose inputs are cut off, what is there cannot be compared: next to nothing.
    assert max(compared) <= 4


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("in_real_time", [False, True])
def test_a_recorder_that_lost_the_last_messages_of_each_link_is_no_difference(
    in_real_time: bool, seed: int, tmp_path: Path
) -> None:
    plan = plan_in_real_time() if in_real_time else plan_of(cycles=25)
    run = TroubledRun(plan, cloudy_profile(plan), seed)
    said = run.run() if in_real_time else lockstep_run(plan, run.profile)
    generator = random.Random(seed)
    # The links of the agents to the recorder end at different moments of the last cycles.
    ends = {port.publisher: generator.randrange(len(said) - 60, len(said)) for port, _ in said}
    left = [pair for place, pair in enumerate(said) if place < ends[pair[0].publisher]]
    left = [pair for pair in left if pair[1] is not said[-1][1]]
    found = verified(tmp_path / "run", run, left)
    assert findings(found) == {}
    assert found.compared > len(said) - 150
