"""A sweep finds the highest rate that is clean, without trying what it need not."""

from __future__ import annotations

import io
import json

import pytest
from msgspec.structs import replace
from rich.console import Console
from timings_by_hand import HOST, TIMINGS, encoded, report, timing

from launch_scripts.timing.distributions import distribution, merged
from launch_scripts.timing.floor import FloorTimes
from launch_scripts.timing.rates import Rates
from launch_scripts.timing.sweep import (
    RateRow,
    Sweep,
    Timed,
    conclusion,
    print_sweep,
    rate_row,
    sweep,
)


class Machine:
    """A machine that keeps up to a rate; it notes what was tried."""

    def __init__(self, highest_hz: float, interrupted_at: float | None = None) -> None:
        self.tried: list[float] = []
        self._highest_hz = highest_hz
        self._interrupted_at = interrupted_at

    def run(self, rate_hz: float) -> tuple[RateRow, bool]:
        self.tried.append(rate_hz)
        row = RateRow(rate_hz, 10, 1e3, 2e3, 3e3, clean=rate_hz <= self._highest_hz)
        return row, rate_hz == self._interrupted_at


@pytest.mark.parametrize("highest_hz", [6.0, 37.0, 74.9, 640.0])
def test_the_highest_clean_rate_is_found_to_ten_percent(highest_hz: float) -> None:
    machine = Machine(highest_hz)
    found = sweep(Rates(search_hz=(5.0, 1000.0)), machine.run)
    assert found.highest_clean_hz is not None
    assert highest_hz / 1.11 <= found.highest_clean_hz <= highest_hz
    assert len(machine.tried) <= 13
    assert [row.rate_hz for row in found.rows] == sorted(machine.tried)


def test_the_search_ends_at_the_ends_of_its_range() -> None:
    slow, fast = Machine(0.5), Machine(1e9)
    assert sweep(Rates(search_hz=(5.0, 1000.0)), slow.run).highest_clean_hz is None
    assert slow.tried == [5.0]
    assert sweep(Rates(search_hz=(30.0, 200.0)), fast.run).highest_clean_hz == 200.0
    assert fast.tried == [30.0, 60.0, 120.0, 200.0]


def test_listed_rates_are_all_tried_and_a_gap_is_not_believed() -> None:
    def bumpy(rate_hz: float) -> tuple[RateRow, bool]:
        return RateRow(rate_hz, clean=rate_hz != 10.0), False

    found = sweep(Rates(listed_hz=(5.0, 10.0, 20.0)), bumpy)
    assert [row.clean for row in found.rows] == [True, False, True]


def test_an_interrupted_sweep_keeps_what_it_has() -> None:
    machine = Machine(1e9, interrupted_at=10.0)
    found = sweep(Rates(listed_hz=(5.0, 10.0, 20.0)), machine.run)
    assert (machine.tried, found.interrupted, len(found.rows)) == ([5.0, 10.0], True, 2)


def test_a_rate_that_was_interrupted_is_neither_clean_nor_not_clean() -> None:
    row = rate_row(replace(report(), interrupted=True))
    assert (row.clean, row.interrupted, row.outcome) == (False, True, "interrupted")
    found = Sweep((RateRow(5.0, clean=True), row), 5.0, interrupted=True)
    console = Console(file=io.StringIO(), width=100)
    print_sweep(found, console)
    assert isinstance(console.file, io.StringIO)
    text = console.file.getvalue()
    assert "interrupted" in text
    assert "not clean" not in text
    assert json.loads(found.as_json())["rows"][1]["interrupted"]
    assert conclusion(found).startswith("highest clean rate: at least 5 cycles/s")


def test_where_the_highest_rate_tried_is_clean_the_limit_is_not_known() -> None:
    rates = Rates(listed_hz=(5.0, 10.0, 20.0))
    assert "clean rate: at least 20 cycles/s" in conclusion(sweep(rates, Machine(1e9).run))
    assert "clean rate: 10 cycles/s" in conclusion(sweep(rates, Machine(10.0).run))


def test_a_rate_is_clean_if_nothing_was_missed_overrun_or_lost() -> None:
    assert rate_row(report()).clean
    assert rate_row(report()).loop_max_us == pytest.approx(30_000.0, rel=0.01)
    assert rate_row(report()).cpu_percent == pytest.approx(80.0)
    assert not rate_row(report(lost=1)).clean
    assert not rate_row(report(cycles=0)).clean
    for late in (timing("c2/d", {}, missed=1), timing("c2/d", {}, overruns=1)):
        assert not rate_row(report((*TIMINGS[:-1], late))).clean


def printed(timed: Timed, rates: Rates, width: int = 100) -> str:
    console = Console(file=io.StringIO(), width=width)
    print_sweep(sweep(rates, timed), console)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_the_table_names_what_failed_and_the_highest_clean_rate() -> None:
    def failing(rate_hz: float) -> tuple[RateRow, bool]:
        if rate_hz > 5.0:
            return RateRow(rate_hz, failed="recorder has not been heard of for 2 s"), False
        return RateRow(rate_hz, 75, 10_500.0, 12_250.0, 13_000.0, clean=True), False

    text = printed(failing, Rates(listed_hz=(5.0, 10.0)))
    assert "10 cycles/s failed: recorder has not been heard of for 2 s" in text
    assert "highest clean rate: 5 cycles/s" in text
    assert all(figure in text for figure in ("200.00", "10.50", "12.25", "13.00"))
    assert "no rate was clean" in printed(Machine(1.0).run, Rates(listed_hz=(5.0, 10.0)))


def test_where_the_first_rate_is_not_clean_lower_ones_are_proposed() -> None:
    found = sweep(Rates(search_hz=(5.0, 1000.0)), Machine(0.5).run)
    assert conclusion(found) == (
        "no rate was clean: 5 cycles/s alone was tried, and was not; slower ones are tried by "
        "--rate 0.5..5"
    )
    several = conclusion(sweep(Rates(listed_hz=(5.0, 10.0)), Machine(0.5).run))
    assert several.startswith("no rate was clean: at each ")
    assert several.endswith("--rate 0.5..5")


def test_of_a_rate_that_is_not_clean_the_tier_is_named() -> None:
    late = (
        *TIMINGS[1:4],
        timing("plant", {}, overruns=1),
        timing("c2/d", {}, missed=3),
    )
    row = rate_row(report(late, lost=2))
    assert row.trouble == (
        "plant overran 1 time, direct missed a deadline 3 times, 2 messages not recorded"
    )
    text = printed(lambda _: (row, False), Rates(listed_hz=(12.5,)))
    assert "12.5 cycles/s was not clean: plant overran 1 time, direct missed" in text
    assert rate_row(report()).trouble == ""


def test_a_sweep_tells_host_policy_load_and_floor() -> None:
    floor = (FloorTimes("timer", distribution(merged([encoded([0.05, 0.25])]))),)
    row = rate_row(report(floor=floor))
    later = replace(row, host=replace(HOST, load_before=1.5, load_after=1.75))
    rows = {5.0: replace(row, rate_hz=5.0), 10.0: replace(later, rate_hz=10.0)}

    text = printed(lambda rate_hz: (rows[rate_hz], False), Rates(listed_hz=(5.0, 10.0)))
    assert "2 CPUs, A processor; load average 0.50 before, 1.75 after" in text
    assert "scheduling: other on CPU 0, 1" in text
    assert "floor at 5 cycles/s [µs]" in text
    assert "floor at 10 cycles/s [µs]" in text
    found = sweep(Rates(listed_hz=(5.0, 10.0)), lambda rate_hz: (rows[rate_hz], False))
    document = json.loads(found.as_json())
    assert [entry["host"]["load_after"] for entry in document["rows"]] == [0.75, 1.75]
    assert document["rows"][0]["floor"][0]["name"] == "timer"


def test_a_rate_that_is_thrown_out_costs_none_before_it() -> None:
    def thrown_out(rate_hz: float) -> tuple[RateRow, bool]:
        if rate_hz > 5.0:
            raise KeyboardInterrupt
        return RateRow(rate_hz, clean=True), False

    found = sweep(Rates(listed_hz=(5.0, 10.0, 20.0)), thrown_out)
    assert [(row.rate_hz, row.outcome) for row in found.rows] == [
        (5.0, "clean"),
        (10.0, "interrupted"),
    ]
    assert found.interrupted


@pytest.mark.parametrize("width", [40, 80])
def test_in_a_narrow_terminal_each_figure_of_a_rate_is_there(width: int) -> None:
    def late(rate_hz: float) -> tuple[RateRow, bool]:
        return RateRow(rate_hz, 1234, 10_510.0, 12_250.0, 13_990.0, 77, 88, 99, 66.0), False

    words = printed(late, Rates(listed_hz=(5.0,)), width).split()
    for figure in ("1,234", "200.00", "10.51", "12.25", "13.99", "77", "88", "99", "66"):
        assert words.count(figure) == 1


def test_the_document_has_a_row_for_each_rate() -> None:
    found = sweep(Rates(listed_hz=(5.0, 10.0)), Machine(5.0).run)
    document = json.loads(found.as_json())
    assert document["highest_clean_hz"] == 5.0
    assert [row["clean"] for row in document["rows"]] == [True, False]
    assert Sweep((), None, interrupted=True).highest_clean_hz is None


class FillingDisk(Machine):
    """A machine whose disk is full from a run on."""

    def __init__(self, highest_hz: float, runs: int) -> None:
        super().__init__(highest_hz)
        self._runs = runs

    def run(self, rate_hz: float) -> tuple[RateRow, bool]:
        row, interrupted = super().run(rate_hz)
        if len(self.tried) > self._runs:
            row = RateRow(rate_hz, failed="run: No space left on device", unwritable=True)
        return row, interrupted


def test_a_rate_that_failed_for_a_full_disk_is_no_upper_bound() -> None:
    listed = sweep(Rates(listed_hz=(5.0, 10.0)), FillingDisk(1e9, runs=1).run)
    assert conclusion(listed).startswith("highest clean rate: at least 5 cycles/s")
    searching = FillingDisk(1e9, runs=2)
    found = sweep(Rates(search_hz=(5.0, 1000.0)), searching.run)
    assert searching.tried == [5.0, 10.0, 20.0], "nothing is looked for below it"
    assert conclusion(found).startswith("highest clean rate: at least 10 cycles/s")


def test_a_search_between_two_bounds_ends_where_the_disk_is_full() -> None:
    searching = FillingDisk(12.0, runs=3)
    found = sweep(Rates(search_hz=(5.0, 1000.0)), searching.run)
    assert searching.tried == [5.0, 10.0, 20.0, 14.1]
    assert conclusion(found).startswith("highest clean rate: 10 cycles/s")


def test_of_failed_and_unclean_rates_no_more_is_said_than_is_true() -> None:
    def mixed(rate_hz: float) -> tuple[RateRow, bool]:
        return RateRow(rate_hz, failed="c1 has died" if rate_hz > 5.0 else ""), False

    assert conclusion(sweep(Rates(listed_hz=(5.0, 10.0)), mixed)) == (
        "no rate was clean: at each a deadline was missed, a stage overran, a message was lost or "
        "the run failed; slower ones are tried by --rate 0.5..5"
    )


def test_where_the_disk_was_full_from_the_beginning_slower_rates_are_not_proposed() -> None:
    found = sweep(Rates(listed_hz=(5.0, 10.0)), FillingDisk(1e9, runs=0).run)
    assert conclusion(found) == "no rate was clean: each one failed"
