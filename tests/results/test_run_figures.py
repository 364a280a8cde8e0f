"""All figures of merit of a run, worked out by hand, and the document that defines them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike
from plans_by_hand import plan_of
from runs_by_hand import RATING_KW, run_of, sine_of_an_hour

from agents.settings import GridSettings, OfferedCommitment, StorageSettings
from recordings.read.series import RunSeries
from results.figures import (
    FIGURES,
    Shown,
    run_figures,
    runs_as_columns,
    shown_in,
)


def test_what_a_storage_gave_and_took_by_hand() -> None:
    plan = plan_of(
        {"c1/a": 500.0},
        cycle_ns=1_800_000_000_000,
        cycles=4,
        storages=(
            StorageSettings(name="s", rating_kw=50.0, capacity_kwh=40.0, discharge_efficiency=0.5),
        ),
    )
    values = {
        "commitment_kw": np.array([100.0, 100.0, 100.0, 100.0]),
        "regulation_kw": np.zeros(4),
        "mpp_kw": np.array([[150.0], [120.0], [70.0], [60.0]]),
        "power_kw": np.array([[120.0], [100.0], [70.0], [60.0]]),
        "storage_power_kw": np.array([[-20.0], [0.0], [20.0], [0.0]]),
        "storage_energy_kwh": np.array([[36.0], [36.0], [16.0], [16.0]]),
    }
    found = run_figures(RunSeries.of(plan, "by hand", values))
    assert {
        name: value
        for name, value in found.items()
        if value is not None
        and name.startswith(("storage", "without-storage", "shortfall-e", "unavoidable-e", "curta"))
    } == pytest.approx(
        {
            "shortfall-energy": 25.0,  # (0 + 0 + 10 + 40) / 2
            "unavoidable-energy": 25.0,
            "without-storage-energy": 35.0,  # (0 + 0 + 30 + 40) / 2
            "storage-out-energy": 10.0,
            "storage-in-energy": 10.0,
            "storage-cycles": 0.5,  # 20 kWh out of the store, of 40 kWh
            "storage-mileage": 30.0,  # 20 + 20 + 20 kW in two hours
            "storage-lowest": 40.0,
            "storage-highest": 90.0,
            "curtailed-energy": 25.0,  # (30 + 20 + 0 + 0) / 2
            "curtailed": 100.0 * 50.0 / 400.0,
        }
    )


def test_a_run_of_four_half_hours_by_hand() -> None:
    run = run_of(
        #             met    short  dark   over
        commitment_kw=[100.0, 100.0, 100.0, 50.0],
        available_kw=[150.0, 120.0, 30.0, 80.0],
        delivered_kw=[100.0, 90.0, 20.0, 70.0],
        cycle_s=1800.0,
        cycles=6,
        ramp_limit_percent_per_min=0.2,
    )
    found = run_figures(run)
    others = {name: value for name, value in found.items() if "battery" not in name}
    assert {name: value for name, value in others.items() if value is not None} == pytest.approx(
        {
            "cycles": 4,
            "planned-cycles": 6,
            "dispatched-energy": 175.0,  # (100 + 100 + 100 + 50) / 2
            "available-energy": 190.0,  # (150 + 120 + 30 + 80) / 2
            "delivered-energy": 140.0,  # (100 + 90 + 20 + 70) / 2
            "shortfall-energy": 45.0,  # (0 + 10 + 80 + 0) / 2
            "unavoidable-energy": 35.0,  # (0 + 0 + 70 + 0) / 2
            "control-caused-energy": 10.0,  # (0 + 10 + 10 + 0) / 2
            # Shares of 50 kW, as fractions of the maximum of the cycle before: 100, 80, 25, 80 kW.
            "without-help-energy": 12.5,  # (0 + 20 + 5 + 0) / 2
            "without-help": 100.0 * 12.5 / 175.0,
            "over-delivered-energy": 10.0,  # (0 + 0 + 0 + 20) / 2
            "satisfied": 100.0 * (1.0 - 45.0 / 175.0),
            "shortfall": 100.0 * 45.0 / 175.0,
            "unavoidable": 20.0,
            "control-caused": 100.0 * 10.0 / 175.0,
            "over-delivered": 100.0 * 10.0 / 175.0,
            "mae": 27.5,  # (0 + 10 + 80 + 20) / 4
            "rmse": np.sqrt(6900.0 / 4.0),
            "mileage": 80.0,  # 0, 10, 80, 0 in two hours
            "curtailed-energy": 50.0,  # (50 + 30 + 10 + 10) / 2
            "curtailed": 100.0 * 50.0 / 190.0,
            "ancillary-potential": 50.0,  # (50 + 20 + 30) / 2
            "rise": 50.0 / 30.0,
            "fall": 70.0 / 30.0,
            "ramp": 70.0 / 30.0,
            "ramp-limit": 2.0,
            "above-ramp-limit": 100.0 / 3.0,
        }
    )


def test_a_plant_whose_meter_is_wrong_is_judged_by_truth_and_by_meter() -> None:
    grid = GridSettings(meter_error_percent=10.0)
    found = run_figures(run_of([100.0] * 4, 150.0, [100.0, 80.0, 100.0, 90.0], grid=grid))
    assert found["control-caused"] == pytest.approx(7.5)
    assert found["over-delivered"] == 0.0
    assert found["metered-control-caused"] == pytest.approx(100.0 * (12.0 + 1.0) / 400.0)
    assert found["metered-over-delivered"] == pytest.approx(100.0 * 20.0 / 400.0)
    exact = run_figures(run_of([100.0] * 4, 150.0, [100.0, 80.0, 100.0, 90.0]))
    assert exact["metered-control-caused"] is None


def test_power_that_nobody_measures_is_a_figure_of_its_own() -> None:
    run = run_of([100.0] * 4, 150.0, 100.0, cycle_s=900.0)
    found = run_figures(replace(run, unknown_kw=np.array([0.0, 0.0, 40.0, 40.0])))
    assert (found["delivered-energy"], found["unknown-energy"]) == (100.0, 20.0)


RAMPS = ("rise", "fall", "ramp", "ramp-limit", "above-ramp-limit")
NONE = (None,) * 5


@pytest.mark.parametrize(
    ("delivered_kw", "cycle_s", "expected"),
    [
        # Cycles of 20 s, so a minute is three: 150 - 100, 130 - 100, 10 - 120, 40 - 150, 40 - 130;
        # minutes of ramps that begin in cycles 0 to 2, and in 3 and 4.
        ([100, 100, 120, 150, 130, 10, 40, 40], 20.0, (50.0, 110.0, 110.0, 100.0, 100.0)),
        # 240 ramps in 4 minutes. Those of cycles 140 to 199 end after the fall of 200 kW.
        (np.repeat([500.0, 300.0], [200, 100]), 1.0, (0.0, 200.0, 200.0, 100.0, 50.0)),
        # A ramp exactly at the limit is allowed.
        (0.1 * RATING_KW / 60.0 * np.arange(300.0), 1.0, (100.0, 0.0, 100.0, 100.0, 0.0)),
        # The nearest to 60 s is two cycles: 20 kW in 50 s.
        ([0.0, 5.0, 20.0], 25.0, (24.0, 0.0, 24.0, 100.0, 0.0)),
        ([0.0, 20.0], 120.0, (10.0, 0.0, 10.0, 100.0, 0.0)),
        ([0.0] * 60, 1.0, NONE),  # A minute or less has no ramp.
    ],
)
def test_a_ramp_is_the_change_over_a_minute_from_every_cycle_on(
    delivered_kw: ArrayLike, cycle_s: float, expected: tuple[float | None, ...]
) -> None:
    power_kw = np.asarray(delivered_kw)
    run = run_of(power_kw, 900.0, power_kw, cycle_s=cycle_s, ramp_limit_percent_per_min=10.0)
    found = run_figures(run)
    assert [found[name] for name in RAMPS] == pytest.approx(list(expected))


def test_regulation_is_desired_but_no_part_of_the_ancillary_potential() -> None:
    run = run_of(
        commitment_kw=[100.0, 100.0],
        available_kw=[150.0, 150.0],
        delivered_kw=[120.0, 100.0],
        regulation_kw=[20.0, -20.0],
        capacity_kw=40.0,
        cycle_s=3600.0,
    )
    found = run_figures(run)
    energies = ("dispatched-energy", "over-delivered-energy", "ancillary-potential")
    assert [found[name] for name in energies] == pytest.approx([200.0, 20.0, 100.0])
    assert found["regd-strict"] == 50.0


# Incomplete recordings ----------------------------------------------------------------------------


def without(run: RunSeries, cycles: slice, *fields: str) -> RunSeries:
    """Return a run as read from a recording that lacks messages of some cycles."""
    arrays = {field: getattr(run, field).copy() for field in fields}
    for values in arrays.values():
        values[cycles] = np.nan
    return replace(run, **arrays)


DISPATCH = ("commitment_kw", "regulation_kw")
PRODUCTION = ("mpp_kw", "power_kw")


def test_changes_across_unknown_cycles_are_no_mileage() -> None:
    run = run_of([100.0] * 6, 900.0, [90.0, 80.0, 80.0, 20.0, 20.0, 30.0], cycle_s=3600.0)
    assert run_figures(run)["mileage"] == pytest.approx((10.0 + 60.0 + 10.0) / 6)
    gap = without(run, slice(2, 3), *PRODUCTION)
    assert run_figures(gap)["mileage"] == pytest.approx((10.0 + 10.0) / 5)


def test_minutes_of_unknown_cycles_count_neither_as_kept_nor_as_too_fast() -> None:
    # The second of four minutes is too fast, the third is not known.
    power_kw = np.repeat([100.0, 300.0], [90, 210])
    grid = GridSettings(ramp_up_kw_per_min=60.0)
    run = run_of(power_kw, 900.0, power_kw, grid=grid)
    assert run_figures(run)["ramp-control"] == pytest.approx(50.0)
    gap = without(run, slice(180, 240), *PRODUCTION)
    assert run_figures(gap)["ramp-control"] == pytest.approx(100.0)


@pytest.mark.parametrize("fields", [DISPATCH, PRODUCTION, DISPATCH + PRODUCTION])
def test_cycles_with_a_message_missing_do_not_count(fields: tuple[str, ...]) -> None:
    whole = run_figures(sine_of_an_hour(response=0.75))
    found = run_figures(without(sine_of_an_hour(response=0.75), slice(900, 910), *fields))
    assert (found["cycles"], found["planned-cycles"]) == (3590, 3600)
    assert found["available-energy"] == pytest.approx(900.0 * 3590 / 3600)
    # The window of the score from 12:15 on has a gap, and the clock of the others does not move.
    same = ("ramp", "precision")
    assert [found[name] for name in same] == pytest.approx([whole[name] for name in same])


# Help, on two clusters of two ---------------------------------------------------------------------

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
        [np.nan, -2.0, -1.0, -1.0],  # not known
    ]
)


@pytest.mark.parametrize(
    ("residual_kw", "inverters", "expected"),
    [
        (RESIDUAL_KW, INVERTERS, [400.0 / 6.0, 50.0]),
        # c1 lacks 1 kW and c2 has 8 kW: a zone that holds both settles it.
        (RESIDUAL_KW[3:4], ("z1/c1/a", "z1/c1/b", "z1/c2/c", "z1/c2/d"), [0.0, 0.0]),
        (RESIDUAL_KW[3:4], ("z1/c1/a", "z1/c1/b", "z2/c2/c", "z2/c2/d"), [100.0, 100.0]),
        # An inverter right below the central controller is a cluster of its own.
        (RESIDUAL_KW[3:4], ("a", "b", "c", "d"), [100.0, 100.0]),
        (RESIDUAL_KW[6:7], INVERTERS, [100.0, None]),  # Never was the plant able.
        (RESIDUAL_KW[:1], INVERTERS, [None, None]),
        (RESIDUAL_KW[7:], INVERTERS, [None, None]),
    ],
)
def test_help_from_outside_is_a_share_of_the_needy_cycles(
    residual_kw: np.ndarray, inverters: tuple[str, ...], expected: list[float | None]
) -> None:
    shape = np.ones(residual_kw.shape)
    values = {"commitment_kw": shape[:, 0], "regulation_kw": 0.0 * shape[:, 0]}
    values |= {"mpp_kw": shape, "power_kw": shape, "residual_kw": residual_kw}
    plan = plan_of(dict.fromkeys(inverters, 100.0), cycles=len(shape))
    found = run_figures(RunSeries.of(plan, "by hand", values))
    names = ("outside-help", "outside-help-able")
    assert [found[name] for name in names] == pytest.approx(expected)


# The list -----------------------------------------------------------------------------------------


def test_runs_stand_side_by_side_with_the_figures_that_one_of_them_defines() -> None:
    regulated = run_figures(sine_of_an_hour(response=0.75))
    plain = run_figures(run_of([100.0] * 4, 150.0, [100.0, 90.0, 20.0, 120.0], cycle_s=900.0))
    figures = shown_in(Shown.REPORT)
    both = runs_as_columns("Runs", [("a", regulated), ("b", plain)], figures)
    rows = {row[0]: row[1:] for row in both.texts()}
    assert rows["Mileage per hour"][0] == "kW/h"
    assert rows["Regulation capacity"] == ("kW", "200", "-")
    alone = runs_as_columns("Runs", [("b", plain)], figures)
    assert "Regulation capacity" not in {row[0] for row in alone.texts()}


def test_the_document_lists_every_figure_with_its_unit() -> None:
    document = Path(__file__).parents[2] / "docs" / "metrics.md"
    rows = [
        line.strip("| ").split(" | ")[0]
        for line in document.read_text(encoding="utf-8").splitlines()
        if line.startswith("| `")
    ]
    units = {one.name: f" [{one.unit}]" if one.unit else "" for one in FIGURES.values()}
    assert rows == [f"`{name}`: {FIGURES[name].title}{unit}" for name, unit in units.items()]


def test_offers_are_kept_where_one_per_cent_is_missing_and_measured_against_firm_energy() -> None:
    run = run_of(
        #              not offered    enough        3 % of one cycle
        commitment_kw=[100.0, 100.0, 100.0, 100.0, 100.0, 100.0],
        available_kw=[10.0, 10.0, 120.0, 120.0, 100.0, 97.0],
        delivered_kw=[10.0, 10.0, 100.0, 100.0, 100.0, 97.0],
        cycle_s=1800.0,
        offers=OfferedCommitment(interval_s=3600.0),
    )
    found = run_figures(run)
    assert (found["intervals"], found["kept-intervals"]) == (2, 50.0)
    # In hindsight 120 kW / 0.99 of the first, and 97 kW / 0.98 of the second interval.
    firm_kwh = 120.0 / 0.99 + 97.0 / 0.98
    assert found["firm-energy"] == pytest.approx(firm_kwh)
    assert found["promised"] == pytest.approx(100.0 * 200.0 / firm_kwh)
    assert {type(value) for value in found.values()} <= {int, float, type(None)}
