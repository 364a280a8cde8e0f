"""Grouping control by hand: three inverters, the first of them the reference group."""

import numpy as np
import pytest

from agents.control.grouping import grouping_levels, grouping_limits_kw

RATING_KW = np.array([100.0, 200.0, 100.0])
REFERENCE = np.array([True, False, False])


@pytest.mark.parametrize(
    ("reference_kw", "dispatch_kw", "control_kw", "level"),
    [
        # The others could give 3 x 80 = 240 kW; 120 kW are wanted of them, 2 : 1.
        (80.0, 200.0, 120.0, 0.5),
        (40.0, 300.0, 120.0, 1.0),  # No more than their potential.
        (80.0, 50.0, 0.0, 0.0),  # The plant cannot go below its reference group.
        (0.0, 100.0, 0.0, 1.0),
    ],
)
def test_the_control_group_shares_what_the_reference_group_leaves(
    reference_kw: float, dispatch_kw: float, control_kw: float, level: float
) -> None:
    seen = np.array([reference_kw]), np.array([dispatch_kw])
    limits_kw = grouping_limits_kw(*seen, RATING_KW, REFERENCE)
    assert limits_kw[0] == pytest.approx([np.inf, control_kw * 2 / 3, control_kw / 3])
    levels = grouping_levels(*seen, RATING_KW, REFERENCE)
    assert levels[0] == pytest.approx([1.0, level, level])
