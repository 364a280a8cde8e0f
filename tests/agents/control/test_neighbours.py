"""Step 3, equation 5: virtual neighbours are asked in ascending order of correlation."""

from agents.control.neighbours import help_order


def test_each_child_asks_the_least_correlated_sibling_first() -> None:
    correlation = [
        [1.0, 0.9, 0.2, 0.5],
        [0.9, 1.0, 0.4, 0.3],
        [0.2, 0.4, 1.0, 0.8],
        [0.5, 0.3, 0.8, 1.0],
    ]
    assert help_order(correlation) == (
        (2, 3, 1),  # 0.2 < 0.5 < 0.9
        (3, 2, 0),  # 0.3 < 0.4 < 0.9
        (0, 1, 3),  # 0.2 < 0.4 < 0.8
        (1, 0, 2),  # 0.3 < 0.5 < 0.8
    )


def test_a_sibling_under_opposite_clouds_comes_before_an_unrelated_one() -> None:
    correlation = [[1.0, 0.0, -0.7], [0.0, 1.0, 0.1], [-0.7, 0.1, 1.0]]
    assert help_order(correlation)[0] == (2, 1)


def test_equal_correlations_keep_the_order_of_the_children() -> None:
    assert help_order([[1.0] * 4] * 4) == ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))


def test_nobody_is_its_own_neighbour_even_where_it_correlates_least_with_itself() -> None:
    assert help_order([[-1.0, 1.0], [1.0, -1.0]]) == ((1,), (0,))


def test_an_only_child_has_nobody_to_ask() -> None:
    assert help_order([[1.0]]) == ((),)
