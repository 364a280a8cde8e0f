"""Where help was found, counted by hand on two clusters of two."""

import numpy as np
import pytest

from studies.metrics.help import CallsForHelp, help_metrics

INVERTERS = ("c1/a", "c1/b", "c2/c", "c2/d")

RESIDUAL_KW = np.array(
    [
        [5.0, 5.0, 5.0, 5.0],  # nobody is in need
        [-3.0, 4.0, 0.0, 1.0],  # a is helped by b
        [-3.0, 3.0, -1.0, 9.0],  # two in need, in two clusters: both are helped, c1 just so
        [-3.0, 2.0, 4.0, 4.0],  # c1 lacks 1 kW, c2 has it: the central controller helps
        [-3.0, 2.0, -5.0, 6.0],  # c1 lacks, c2 settles its own and has 1 kW over: just enough
        [-3.0, 2.0, -5.0, 5.5],  # the plant lacks half a kilowatt
        [-3.0, -2.0, -1.0, -1.0],  # everybody is in need
    ]
)


def test_calls_are_counted_by_plant_and_by_cluster() -> None:
    found = help_metrics(RESIDUAL_KW, INVERTERS)
    assert found.cycles == 7
    assert found.plant == CallsForHelp(needy=6, central=4)
    assert found.clusters == CallsForHelp(needy=1 + 2 + 1 + 2 + 2 + 2, central=1 + 1 + 1 + 2)
    # Without the cycles in which the plant lacks power:
    assert found.plant_sufficient == CallsForHelp(needy=4, central=2)
    assert found.plant_sufficient.central_percent == 50.0
    assert found.clusters_sufficient == CallsForHelp(needy=6, central=2)


@pytest.mark.parametrize(
    ("inverters", "central"),
    [
        # c1 lacks 1 kW and c2 has 8 kW: a zone that holds both settles it.
        (("z1/c1/a", "z1/c1/b", "z1/c2/c", "z1/c2/d"), 0),
        (("z1/c1/a", "z1/c1/b", "z2/c2/c", "z2/c2/d"), 1),
        # An inverter right below the central controller is a cluster of its own.
        (("a", "b", "c", "d"), 1),
    ],
)
def test_what_a_child_of_the_central_controller_settles_does_not_reach_the_top(
    inverters: tuple[str, ...], central: int
) -> None:
    assert help_metrics(RESIDUAL_KW[3:4], inverters).plant == CallsForHelp(1, central)


def test_without_need_there_is_no_share() -> None:
    assert help_metrics(np.ones((3, 4)), INVERTERS).plant.central_percent is None
