"""Step 3, equation 5: virtual neighbours are asked in ascending order of correlation."""

import pytest

from agents.control.neighbours import help_order


@pytest.mark.parametrize(
    ("correlation", "order"),
    [
        (
            [[1.0, 0.9, 0.2, 0.5], [0.9, 1.0, 0.4, 0.3], [0.2, 0.4, 1.0, 0.8], [0.5, 0.3, 0.8, 1]],
            ((2, 3, 1), (3, 2, 0), (0, 1, 3), (1, 0, 2)),
        ),
        ([[1.0, 0.0, -0.7], [0.0, 1.0, 0.1], [-0.7, 0.1, 1.0]], ((2, 1), (0, 2), (0, 1))),
        ([[1.0] * 4] * 4, ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))),
        ([[-1.0, 1.0], [1.0, -1.0]], ((1,), (0,))),
        ([[1.0]], ((),)),
    ],
    ids=["plain", "opposite before unrelated", "alike: as listed", "never oneself", "only child"],
)
def test_each_child_asks_the_least_correlated_sibling_first(
    correlation: list[list[float]], order: tuple[tuple[int, ...], ...]
) -> None:
    assert help_order(correlation) == order
