"""A sweep finds the highest rate that is clean, and keeps what it has measured."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import pytest
from msgspec.structs import replace
from printing import printed
from reports_by_hand import missed, reported
from timed_recordings import cycle

from bus_schemas.errors import FailureError, InputError
from results.report.result import print_result
from results.timing.report import TimingReport
from studies.timing import RateRow, parse_rates, sweep, sweep_result


def clean_hz(rows: list[RateRow]) -> float:
    return max(row.rate_hz for row in rows if row.outcome == "clean")


def at(report: TimingReport, **changes: Any) -> TimingReport:
    """The same run, but for some facts."""
    return dataclasses.replace(report, run=replace(report.run, **changes))


Reports = tuple[TimingReport, TimingReport]


class Machine:
    """A machine that keeps up to a rate, but for what happens at some; it notes what was tried."""

    def __init__(
        self, reports: Reports, highest_hz: float, at: dict[float, BaseException] | None = None
    ) -> None:
        self.tried: list[float] = []
        self._reports = reports
        self._highest_hz = highest_hz
        self._at = at or {}

    def run(self, rate_hz: float) -> TimingReport:
        self.tried.append(rate_hz)
        if rate_hz in self._at:
            raise self._at[rate_hz]
        return at(self._reports[rate_hz > self._highest_hz], rate_hz=rate_hz)


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> Reports:
    """A report on a run that was clean, and on one that was not."""
    folder = tmp_path_factory.mktemp("sweep")
    clean = reported(folder / "clean")
    return clean, reported(folder / "late", cycle(0), missed(1), lost=2)


@pytest.mark.parametrize("highest_hz", [6.0, 37.0, 74.9, 640.0])
def test_the_highest_clean_rate_is_found_to_ten_percent(
    highest_hz: float, reports: Reports
) -> None:
    machine = Machine(reports, highest_hz)
    found = sweep(5.0, 1000.0, machine.run)
    assert highest_hz / 1.11 <= clean_hz(found) <= highest_hz
    assert len(set(machine.tried)) <= 13
    assert [row.rate_hz for row in found] == sorted(set(machine.tried))


def test_a_rate_that_was_not_clean_is_run_once_more(reports: Reports) -> None:
    """One stall of the machine at 10 cycles/s does not end the search."""
    machine, unlucky = Machine(reports, 25.0), [10.0]

    def timed(rate_hz: float) -> TimingReport:
        found = machine.run(rate_hz)
        if rate_hz in unlucky:
            unlucky.remove(rate_hz)
            return at(reports[1], rate_hz=rate_hz)
        return found

    found = sweep(5.0, 1000.0, timed)
    assert clean_hz(found) > 25.0 / 1.11
    assert [machine.tried.count(rate_hz) for rate_hz in (10.0, 20.0, 40.0)] == [2, 1, 2]


def test_a_run_that_fails_or_is_refused_ends_the_search_above_it_but_the_first_is_refused(
    reports: Reports,
) -> None:
    for why in (FailureError("c1 has died\nits log says so"), InputError("c1 has died")):
        found = sweep(5.0, 20.0, Machine(reports, 1e9, {10.0: why}).run)
        assert {row.rate_hz: row.outcome for row in found}[10.0] == "failed"
        assert 10.0 / 1.11 <= clean_hz(found) < 10.0
        text = printed(partial(print_result, result=sweep_result(found, "field")))
        assert "failed  c1 has died" in text
        assert "13.600" in text, "the loop [ms]"
    with pytest.raises(InputError, match="c1 has died"):
        sweep(10.0, 20.0, Machine(reports, 1e9, {10.0: why}).run)


@pytest.mark.parametrize(
    ("text", "rates"),
    [
        ("20", (20.0, 20.0)),
        ("0.5", (0.5, 0.5)),
        ("1..200", (1.0, 200.0)),
        ("auto", (5.0, 1000.0)),
    ],
)
def test_rates_are_read(text: str, rates: tuple[float, float]) -> None:
    assert parse_rates(text) == rates


@pytest.mark.parametrize(
    "text", ["0", "-5", "nan", "fast", "5,10", "1001", "inf", "20..10", "5..5", "10..2000", ""]
)
def test_other_texts_than_rates_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="--rate: expected"):
        parse_rates(text)


def test_an_interrupted_sweep_keeps_what_it_has(reports: Reports) -> None:
    found = sweep(5.0, 20.0, Machine(reports, 1e9, {10.0: KeyboardInterrupt()}).run)
    assert [row.outcome for row in found] == ["clean", "interrupted"]
    cut = at(reports[0], interrupted=True)
    assert [row.outcome for row in sweep(10.0, 20.0, lambda _: cut)] == ["interrupted"]
