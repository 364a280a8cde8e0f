"""Headroom and ancillary potential, worked out by hand."""

import numpy as np

from studies.metrics.headroom import HeadroomMetrics, headroom_metrics


def test_energies_of_three_half_hours() -> None:
    found = headroom_metrics(
        commitment_kw=np.array([60.0, 60.0, 60.0]),
        possible_kw=np.array([100.0, 80.0, 40.0]),
        delivered_kw=np.array([70.0, 80.0, 30.0]),
        cycle_s=1800.0,
    )
    assert found == HeadroomMetrics(
        headroom_kwh=20.0,  # (30 + 0 + 10) / 2
        mean_headroom_kw=40.0 / 3.0,
        ancillary_potential_kwh=30.0,  # (40 + 20 + 0) / 2: the third has nothing to offer
    )


def test_more_delivered_than_was_possible_is_no_negative_headroom() -> None:
    one, two = np.array([1.0]), np.array([2.0])
    assert headroom_metrics(one, one, two, 3600.0).headroom_kwh == 0.0
