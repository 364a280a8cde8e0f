"""Campaigns of random faults: they hold, they repeat, and they find bugs that were planted."""

from __future__ import annotations

import pytest
from campaign import Broken, healthy, judged_healthy, plant_of, run_plant, run_seed, run_under
from faults import Down, Stall, Zombie, end_s, faults_of
from judges import violations
from planted_bugs import BUGS, planted
from plants import PLANTS, prepared

from agents.faults import Freeze, Kill, Trip
from bus_schemas.faults import Blackout, Disturbance, Partition

SEEDS = range(1, 101)


SMALL = [name for name in PLANTS if name not in {"oahu", "valley"}]


@pytest.mark.parametrize("plant", SMALL)
def test_each_plant_holds_and_is_worth_what_it_was_and_a_seed_of_it_holds(plant: str) -> None:
    assert judged_healthy(plant) == []
    assert plant == "day" or run_seed(8, plant) is None  # A run of it takes seconds.


@pytest.mark.parametrize("bug", ["an inverter ramps by the cycle", "an order is followed too fast"])
def test_a_bug_in_one_function_is_found(bug: str) -> None:
    healthy.cache_clear()
    with planted(BUGS[bug]):
        assert run_plant("orders") is not None
    healthy.cache_clear()


def test_a_plant_that_stood_still_for_longer_than_it_makes_up_for_skips_cycles_and_holds() -> None:
    run = run_under("orders", (Stall((14.5, 40.0)),))
    assert len(run.trace.cycles) < run.plan.timing.cycles - 20
    assert [*violations(run)] == []


def test_a_seed_gives_the_same_run_again() -> None:
    faults = faults_of(healthy("orders").plan, 5)
    runs = [run_under("orders", faults).trace.delivered_kw.tolist() for _ in range(2)]
    assert runs[0] == runs[1]


def test_faults_of_all_kinds_outlast_every_time_out() -> None:
    drawn = [fault for seed in SEEDS for fault in faults_of(prepared("periods").plan, seed)]
    kinds = {Kill, Freeze, Trip, Partition, Blackout, Disturbance, Down, Zombie, Stall}
    assert {type(one) for one in drawn} == kinds
    assert sum(end_s(one) - one.at[0] > 65.0 for one in drawn if isinstance(one.at, tuple)) > 10


def found_by(bug: str) -> Broken | None:
    """The first plant or seed that breaks."""
    healthy.cache_clear()
    with planted(BUGS[bug]):
        runs = (run_plant(plant) for plant in PLANTS)
        seeds = (run_seed(seed, plant_of(seed)) for seed in SEEDS)
        return next((one for several in (runs, seeds) for one in several if one), None)


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("bug", BUGS)
def test_a_planted_bug_is_found(bug: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = found_by(bug)
    healthy.cache_clear()
    assert found is not None, "nothing found it"
    with capsys.disabled():
        judges = ", ".join(one.judge for one in found.violations)
        print(f"\n| {bug} | {found.plant} | {found.seed} | {judges} |")
