"""The tables and the figure of a comparison show shortfall and over-delivery together."""

from __future__ import annotations

from results_by_hand import case, result

from studies.compare.page import frontier
from studies.compare.tables import case_tables, cases_tables

SCHEMES = (
    result("uncontrolled", None, 0.0, 40.0, 900.0),
    result("uniform-cap", "fraction", 2.0, 0.0, 80.0),
    result("paper", "fraction", 1.0, 0.5, 90.0),
    result("paper", "limit", 1.5, 0.7, 85.0),
    result("predictive", "fraction", 0.1, 2.0, 79.999),
)


def test_the_best_of_each_column_is_marked_and_bounds_do_not_compete() -> None:
    (table,) = case_tables("day", SCHEMES)
    assert [column.name or column.title for column in table.columns[:5]] == [
        "scheme",
        "actuator",
        "control-caused",
        "over-delivered",
        "rmse",
    ]
    assert [row[:5] for row in table.texts()] == [
        ("uncontrolled", "-", "0.000", "40.000", "900.00"),
        ("uniform-cap", "fraction", "2.000", "*0.000", "*80.00"),
        ("paper", "fraction", "1.000", "0.500", "90.00"),
        ("paper", "limit", "1.500", "0.700", "85.00"),
        ("predictive", "fraction", "*0.100", "2.000", "*80.00"),
    ]


def test_more_is_better_where_more_is_better() -> None:
    (table,) = case_tables("day", SCHEMES)
    place = [column.name for column in table.columns].index("satisfied")
    marked = [row[0] for row in table.texts() if row[place].startswith("*")]
    assert marked == ["predictive"]


def test_what_is_alike_everywhere_is_not_marked() -> None:
    (table,) = case_tables("day", SCHEMES)
    place = [column.name for column in table.columns].index("unavoidable")
    assert {row[place] for row in table.texts()} == {"0.000"}


def test_many_cases_have_both_axes_and_mean_and_quantiles() -> None:
    cases = [case(f"seed={seed}", {"paper": float(seed)}) for seed in (1, 2, 3)]
    table, caused, beyond = cases_tables(["control-caused", "over-delivered"], cases)
    assert table.texts() == [
        ("seed=1", "1.000 (0.000)"),
        ("seed=2", "2.000 (0.000)"),
        ("seed=3", "3.000 (0.000)"),
        ("mean", "2.000 (0.000)"),
        ("5 %", "1.100 (0.000)"),
        ("median", "2.000 (0.000)"),
        ("95 %", "2.900 (0.000)"),
    ]
    assert caused.texts() == [
        ("paper", "fraction", "2.000", "2.484", "1.100", "2.000", "2.900", "-", "-")
    ]
    assert beyond.texts()[0][2:4] == ("0.000", "0.000")


def test_the_frontier_leaves_out_what_another_scheme_beats_in_both() -> None:
    by_fraction, by_limit, line = frontier(SCHEMES).figure.data
    points = [list(zip(one.x, one.y, strict=True)) for one in (by_fraction, by_limit, line)]
    # Without over-delivery a scheme stands at the end of the logarithmic axis.
    assert points[:2] == [[(0.001, 2.0), (0.5, 1.0), (2.0, 0.1)], [(0.7, 1.5)]]
    assert points[2] == [(0.001, 2.0), (0.5, 1.0), (0.7, 1.0), (2.0, 0.1)]
    assert "80 kW" in by_fraction.text[0]
