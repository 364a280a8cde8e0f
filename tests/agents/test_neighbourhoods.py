"""The order of help in time: each hour has its own virtual neighbours."""

from __future__ import annotations

import pytest
from plans_by_hand import CYCLE_NS, plan_of
from plants_by_hand import hear

from agents.plan import Neighbourhood, NodeNeighbourhoods
from bus_schemas.messages import HelpGiven
from bus_schemas.signals import SETPOINT
from bus_schemas.tree import ROOT


def hour(from_cycle: int, a_and_b: float, a_and_c: float) -> Neighbourhood:
    """Correlations of a with its siblings, from a cycle on."""
    return Neighbourhood(
        from_cycle * CYCLE_NS,
        ((1.0, a_and_b, a_and_c), (a_and_b, 1.0, 0.0), (a_and_c, 0.0, 1.0)),
    )


def helpers_of_a(cycles: int, *hours: Neighbourhood, parent: str = ROOT) -> list[str]:
    """Who helps a, which lacks 20 of its 30 kW, in each cycle."""
    prefix = f"{parent}/" if parent else ""
    leaves = [f"{prefix}{name}" for name in "abc"]
    plan = plan_of(
        dict.fromkeys(leaves, 100.0),
        cycles=cycles,
        neighbourhoods=(NodeNeighbourhoods(parent, hours),) if hours else (),
    )
    heard = hear(plan, [[10.0, 80.0, 80.0]] * cycles, [90.0] * cycles)
    found = []
    for cycle in range(cycles):
        setpoints = {leaf: heard.of(SETPOINT.of(leaf))[cycle] for leaf in leaves}
        lines = {leaf: setpoint.help_given for leaf, setpoint in setpoints.items()}
        (helper,) = [leaf for leaf, given in lines.items() if given]
        (line,) = lines[helper]
        assert line == HelpGiven(leaves[0], line.power_kw)
        assert line.power_kw == pytest.approx(20.0)
        found.append(helper)
    return found


def test_the_order_changes_with_the_hour() -> None:
    hours = (hour(0, a_and_b=0.1, a_and_c=0.5), hour(2, a_and_b=0.5, a_and_c=0.1))
    assert helpers_of_a(4, *hours) == ["b", "b", "c", "c"]


def test_before_the_first_hour_its_order_holds_already() -> None:
    hours = (hour(1, a_and_b=0.5, a_and_c=0.1), hour(2, a_and_b=0.1, a_and_c=0.5))
    assert helpers_of_a(3, *hours) == ["c", "c", "b"]


def test_without_history_siblings_are_asked_in_their_own_order() -> None:
    assert helpers_of_a(1) == ["b"]


def test_a_cluster_has_neighbours_of_its_own() -> None:
    assert helpers_of_a(1, hour(0, a_and_b=0.5, a_and_c=0.1), parent="c1") == ["c1/c"]
