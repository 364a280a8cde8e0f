"""Tables show the figures of merit of each run, and nothing where a run does not define one."""

from __future__ import annotations

import pytest
from synthetic_runs import cloudy_run, without_estimates

from studies.metrics import run_metrics
from studies.report.metrics_tables import NOT_DEFINED, metrics_tables
from studies.report.tables import ReportTable


def row(table: ReportTable, name: str) -> tuple[str, tuple[str, ...]]:
    """Unit and values of a row."""
    (found,) = [(unit, values) for called, unit, values in table.rows if called == name]
    return found


def test_runs_stand_side_by_side_with_their_units() -> None:
    run = cloudy_run("hierarchical")
    other = without_estimates(run, "no help")
    (table,) = metrics_tables([run, other])
    assert table.columns == ("hierarchical", "no help")
    unit, values = row(table, "Unsatisfied commitment")
    assert unit == "kWh"
    assert values == tuple(
        f"{run_metrics(one).commitment.unsatisfied_kwh:,.2f}" for one in (run, other)
    )


def test_mileage_in_a_time_has_that_time_in_its_unit() -> None:
    run = cloudy_run()
    (table,) = metrics_tables([run])
    support = run_metrics(run).support
    name = "Mileage of the support power, "
    assert row(table, f"{name}whole run") == ("kW", (f"{support.total_kw:,.0f}",))
    assert row(table, f"{name}per hour") == ("kW/h", (f"{support.per_hour_kw:,.0f}",))
    assert row(table, f"{name}per minute") == ("kW/min", (f"{support.per_minute_kw:,.1f}",))


def test_thousands_are_parted() -> None:
    (table,) = metrics_tables([cloudy_run(cycles=3600 * 10)])
    assert row(table, "Desired energy") == ("kWh", ("2,500.0",))


def test_regulation_has_a_table_of_its_own() -> None:
    run = cloudy_run(regulation=True)
    kept, followed = metrics_tables([run])
    assert kept.heading != followed.heading
    assert row(followed, "Regulation capacity") == ("kW", ("50",))
    regulation = run_metrics(run).regulation
    assert regulation is not None
    for request in regulation.requests:
        name = f"Requests fulfilled to {request.tolerance_percent:g} % of the rating"
        assert row(followed, name) == ("%", (f"{request.fulfilled_percent:,.2f}",))


def test_without_regulation_there_is_one_table() -> None:
    assert len(metrics_tables([cloudy_run()])) == 1


def test_what_a_short_run_does_not_define_is_no_number() -> None:
    kept, followed = metrics_tables([cloudy_run(cycles=30, regulation=True)])
    assert row(kept, "Largest rise") == ("kW/min", (NOT_DEFINED,))
    assert row(followed, "Performance score") == ("", (NOT_DEFINED,))


@pytest.mark.parametrize("regulated_first", [True, False])
def test_beside_a_run_with_regulation_one_without_it_has_no_numbers(regulated_first: bool) -> None:
    runs = [cloudy_run("with", regulation=True), cloudy_run("without")]
    tables = metrics_tables(runs if regulated_first else runs[::-1])
    _, values = row(tables[1], "Regulation capacity")
    assert set(values) == {"50", NOT_DEFINED}
