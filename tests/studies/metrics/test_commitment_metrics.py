"""Figures of merit of a run, worked out by hand."""

from __future__ import annotations

from dataclasses import astuple

import pytest

from studies.metrics import CommitmentMetrics, commitment_metrics

HALF_AN_HOUR_S = 1800.0


def test_energies_of_a_run_of_four_cycles() -> None:
    #             met    short  dark   over
    desired_kw = [100.0, 100.0, 100.0, 50.0]
    possible_kw = [150.0, 120.0, 30.0, 80.0]
    delivered_kw = [100.0, 90.0, 20.0, 70.0]
    found = commitment_metrics(desired_kw, possible_kw, delivered_kw, HALF_AN_HOUR_S)
    assert found == CommitmentMetrics(
        desired_kwh=175.0,  # (100 + 100 + 100 + 50) / 2
        possible_kwh=190.0,  # (150 + 120 + 30 + 80) / 2
        delivered_kwh=140.0,  # (100 + 90 + 20 + 70) / 2
        unsatisfied_kwh=45.0,  # (0 + 10 + 80 + 0) / 2
        unavoidable_kwh=35.0,  # (0 + 0 + 70 + 0) / 2
        control_caused_kwh=10.0,  # (0 + 10 + 10 + 0) / 2
        over_delivered_kwh=10.0,  # (0 + 0 + 0 + 20) / 2
    )
    assert found.satisfied_percent == pytest.approx(100.0 * (1.0 - 45.0 / 175.0))
    assert found.percent(found.unavoidable_kwh) == pytest.approx(20.0)


def test_delivery_above_the_commitment_does_not_make_up_for_delivery_below_it() -> None:
    found = commitment_metrics([100.0, 100.0], [150.0, 150.0], [80.0, 120.0], 3600.0)
    assert (found.unsatisfied_kwh, found.over_delivered_kwh) == (20.0, 20.0)


def test_a_commitment_that_is_kept_is_satisfied_in_full() -> None:
    found = commitment_metrics([100.0], [150.0], [100.0], 1.0)
    assert found.satisfied_percent == 100.0
    assert found.control_caused_kwh == 0.0


def test_where_nothing_was_desired_no_share_of_it_is_defined() -> None:
    found = commitment_metrics([0.0, 0.0], [10.0, 10.0], [5.0, 5.0], 3600.0)
    assert (found.satisfied_percent, found.percent(found.over_delivered_kwh)) == (None, None)


def test_a_run_without_cycles_has_no_energy() -> None:
    assert astuple(commitment_metrics([], [], [], 1.0)) == (0.0,) * 7


def test_series_of_different_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="desired, possible and delivered power differ in length"):
        commitment_metrics([1.0, 2.0], [1.0, 2.0], [1.0], 1.0)
