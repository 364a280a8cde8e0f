"""Tables, statistics and the figure of a comparison, from results written down one by one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from typing import Any

from results.figures import FIGURES, energy_figures
from studies.compare.frontier import frontier
from studies.compare.results import case_tables, cases_tables, summaries
from studies.compare.study import Row


def result(
    scheme: str, actuator: str | None, caused: float, beyond: float = 0.0, rmse_kw: float = 0.0
) -> Row:
    """A scheme that was to deliver 100 kWh in two hours: its energies are per cents."""
    energies = energy_figures([50, 50], [100, 100], [50 - caused, 50 + beyond], 3600.0)
    known = {"rmse": rmse_kw, "outside-help": 0.0, "remarks": ""}
    return {"scheme": scheme, "actuator": actuator, **dict.fromkeys(FIGURES), **energies, **known}


def case(columns: Mapping[str, object], caused: Mapping[str, float]) -> list[Row]:
    """A case with the fraction actuator: control-caused shortfall of each scheme in %."""
    return [{**columns, **result(name, "fraction", value)} for name, value in caused.items()]


SCHEMES = (
    result("uncontrolled", None, 0.0, 40.0, 900.0),
    result("uniform-cap", "fraction", 2.0, 0.0, 80.0),
    result("paper", "fraction", 1.0, 0.5, 90.0),
    result("paper", "limit", 1.5, 0.7, 85.0),
    result("predictive", "fraction", 0.1, 2.0, 79.999),
)


# One case -----------------------------------------------------------------------------------------


def test_the_best_of_each_column_is_marked_and_bounds_do_not_compete() -> None:
    table, _ = case_tables("day", SCHEMES)
    assert table.names()[:5] == ["scheme", "actuator", "control-caused", "over-delivered", "rmse"]
    assert [row[:5] for row in table.texts()] == [
        ("uncontrolled", "-", "0.000", "40.000", "900.00"),
        ("uniform-cap", "fraction", "2.000", "*0.000", "*80.00"),
        ("paper", "fraction", "1.000", "0.500", "90.00"),
        ("paper", "limit", "1.500", "0.700", "85.00"),
        ("predictive", "fraction", "*0.100", "2.000", "*80.00"),
    ]
    more_is_better, alike = map(table.names().index, ("satisfied", "unavoidable"))
    marked = [row[0] for row in table.texts() if row[more_is_better].startswith("*")]
    assert marked == ["predictive"]
    assert {row[alike] for row in table.texts()} == {"0.000"}


def test_the_frontier_leaves_out_what_another_scheme_beats_in_both() -> None:
    by_fraction, by_limit, line = frontier(SCHEMES).figure.data
    points = [
        [(round(x, 9), round(y, 9)) for x, y in zip(one.x, one.y, strict=True)]
        for one in (by_fraction, by_limit, line)
    ]
    # Without over-delivery a scheme stands at the end of the logarithmic axis.
    assert points[:2] == [[(0.001, 2.0), (0.5, 1.0), (2.0, 0.1)], [(0.7, 1.5)]]
    assert points[2] == [(0.001, 2.0), (0.5, 1.0), (0.7, 1.0), (2.0, 0.1)]
    assert "80 kW" in by_fraction.text[0]


# Many cases ---------------------------------------------------------------------------------------


def test_many_cases_have_a_row_each_and_each_figure_its_summary() -> None:
    cases = [
        case({"seed": seed}, {"paper": float(seed), "predictive": predictive})
        for seed, predictive in ((1, 0.0), (2, 0.0), (3, 3.0))
    ]
    table, caused, beyond = cases_tables(["control-caused", "over-delivered"], cases)
    assert table.texts() == [
        ("seed=1", "1.000 (0.000)", "0.000 (0.000)"),
        ("seed=2", "2.000 (0.000)", "0.000 (0.000)"),
        ("seed=3", "3.000 (0.000)", "3.000 (0.000)"),
    ]
    # 2.484: of three values with a standard deviation of 1, Student's t for 2 degrees of freedom.
    # In the three cases paper causes 1, 2 and 0 more than predictive.
    spread = ("2.000", "2.484", "1.100", "2.000", "2.900")
    assert caused.texts()[0] == ("paper", "fraction", *spread, "1.000", "2.484")
    assert caused.texts()[1][-2:] == ("-", "-")
    assert beyond.texts()[0][2:4] == ("0.000", "0.000")


def summaries_of(cases: Sequence[list[Row]]) -> list[Any]:
    """The summaries of the control-caused shortfall; None where there is no figure."""
    found = summaries(cases, ["control-caused"]).astype(object)
    return list(found.where(found.notna(), None).itertuples())


def test_schemes_are_paired_with_the_baseline_of_their_own_actuator() -> None:
    schemes = (
        result("paper", "fraction", 5.0),
        result("paper", "limit", 7.0),
        result("predictive", "fraction", 1.0),
        result("predictive", "limit", 2.0),
        result("uncontrolled", None, 0.0),
    )
    cases = [[{"seed": seed, **row} for row in schemes] for seed in (1, 2)]
    found = [
        (one.scheme, one.actuator, one.difference and round(one.difference, 9))
        for one in summaries_of(cases)
    ]
    assert found == [
        ("paper", "fraction", 4.0),
        ("paper", "limit", 5.0),
        ("predictive", "fraction", None),
        ("predictive", "limit", None),
        ("uncontrolled", None, -1.0),
    ]


def test_a_sweep_of_settings_is_listed_and_not_summarised() -> None:
    cases = [case({"commitment.share": share}, {"paper": share}) for share in (0.5, 0.7)]
    (table,) = cases_tables(["control-caused"], cases)
    assert table.texts() == [("share=0.5", "0.500"), ("share=0.7", "0.700")]


def test_a_scheme_without_one_of_both_figures_is_not_drawn_at_zero() -> None:
    undefined = {**result("paper", "limit", 1.0, 0.2), "over-delivered": None}
    assert len(frontier([*SCHEMES, undefined]).figure.data[1].x) == 1


def test_days_in_a_row_are_no_independent_draws_and_have_no_interval() -> None:
    cases = [case({"day": date(2010, 4, day)}, {"paper": float(day)}) for day in (1, 2)]
    _, summary = cases_tables(["control-caused"], cases)
    assert "± 95 %" not in [column.title for column in summary.columns]
    assert summary.texts()[0][2] == "1.500"
