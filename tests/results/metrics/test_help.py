"""Where help was found, counted by hand on two clusters of two."""

import numpy as np
import pytest

from results.metrics.help import HelpMetrics, help_metrics

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


def test_needy_cycles_and_those_settled_outside_a_cluster_are_counted() -> None:
    found = help_metrics(RESIDUAL_KW, INVERTERS)
    assert found == HelpMetrics(needy=6, outside=4, needy_able=4, outside_able=2)
    assert found.outside_able_percent == 50.0


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
    assert help_metrics(RESIDUAL_KW[3:4], inverters).outside == central


def test_without_need_there_is_no_share() -> None:
    assert help_metrics(np.ones((3, 4)), INVERTERS).outside_percent is None
