"""Tiers that act every m-th cycle: between their turns those below rebalance on their own."""

from __future__ import annotations

import pytest
from memory_runs import Sent
from plans_by_hand import plan_of
from plants_by_hand import hear

from agents.cycle import Periods
from bus_schemas.errors import InputError
from bus_schemas.messages import HelpGiven
from bus_schemas.signals import COMMAND, IMPP, RESIDUAL, SETPOINT

FOUR = {"c1/a": 100.0, "c1/b": 100.0, "c2/a": 100.0, "c2/b": 100.0}
CYCLES = 12


@pytest.fixture(scope="module")
def heard() -> Sent:
    """The central controller acts every 10th cycle, the supervisors in each.

    200 kW are dispatched, 120 kW from cycle 5 on. All inverters could give 80 kW, but a cloud
    stands over c1/a from cycle 3 (20 kW). What happens in a cycle is measured in the next.
    """
    mpp_kw = [[20.0 if cycle >= 3 else 80.0, 80.0, 80.0, 80.0] for cycle in range(CYCLES)]
    dispatch_kw = [200.0 if cycle < 5 else 120.0 for cycle in range(CYCLES)]
    plan = plan_of(FOUR, cycles=CYCLES, period_cycles=(10, 1))
    return hear(plan, mpp_kw, dispatch_kw)


def setpoints_kw(heard: Sent, cycle: int) -> list[float]:
    found = [heard.of(SETPOINT.of(leaf))[cycle].power_kw for leaf in FOUR]
    assert found == pytest.approx([round(power_kw, 9) for power_kw in found], abs=1e-9)
    return [round(power_kw, 9) for power_kw in found]


def test_setpoints_are_sent_in_their_turns_all_else_in_every_cycle(heard: Sent) -> None:
    assert list(heard.of(SETPOINT.of("c1"))) == [0, 10]
    reports = [signal.of(node) for signal in (IMPP, RESIDUAL) for node in ("", "c1", "c2", *FOUR)]
    for port in (*reports, *map(COMMAND.of, FOUR), SETPOINT.of("c1/a")):
        assert list(heard.of(port)) == list(range(CYCLES))


@pytest.mark.parametrize("cycles", [3, 10, 11])
def test_nothing_is_sent_in_a_cycle_that_does_not_take_place(cycles: int) -> None:
    plan = plan_of(FOUR, cycles=cycles, period_cycles=(10, 1))
    found = hear(plan, [[80.0] * 4] * cycles, [200.0] * cycles)
    sent_in = {m.cycle for port, m in found.messages if port.signal.is_cyclic}
    assert sent_in == set(range(cycles))


def test_between_turns_a_cluster_rebalances_against_its_last_target(heard: Sent) -> None:
    # 200 kW / 4 = 50 kW each, so 100 kW for each cluster.
    assert setpoints_kw(heard, 3) == [50.0, 50.0, 50.0, 50.0]
    # The cloud over c1/a is measured in cycle 4: c1/b gives the 30 kW that it lacks.
    assert setpoints_kw(heard, 4) == [20.0, 80.0, 50.0, 50.0]
    assert heard.of(SETPOINT.of("c1/b"))[4].help_given == (
        HelpGiven("c1/a", pytest.approx(30.0)),  # type: ignore[arg-type]
    )


def test_between_turns_a_new_dispatch_changes_what_is_reported_and_not_the_targets(
    heard: Sent,
) -> None:
    assert setpoints_kw(heard, 5) == [20.0, 80.0, 50.0, 50.0]
    # Everybody hears the dispatch: of 120 kW the share of c2/a is 30 kW.
    assert heard.of(RESIDUAL.of("c2/a"))[5].power_kw == pytest.approx(50.0)
    assert setpoints_kw(heard, 10) == [20.0, 40.0, 30.0, 30.0], "in its turn it divides anew"


def test_in_arming_rounds_everybody_acts() -> None:
    assert all(Periods((10, 5)).is_turn("", cycle) for cycle in range(-20, 0))


@pytest.mark.parametrize(
    ("periods", "field"),
    [
        ((0,), "[0]: expected"),
        ((10, -1), "[1]: expected"),
        ((10, 3), "[0]: expected"),
        ((12, 4, 8), "[1]: expected"),
    ],
)
def test_periods_that_do_not_fit_are_refused(periods: tuple[int, ...], field: str) -> None:
    with pytest.raises(InputError) as caught:
        Periods(periods)
    assert f"control.period_cycles{field}" in str(caught.value)
