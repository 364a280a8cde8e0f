"""What the plant offers is kept as often as asked for, and never rests on what was only assumed."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isnan, nan

import numpy as np
import pytest

from agents.control.offers import (
    GROWTH,
    MISSED_SHARE,
    OfferSettings,
    firm_share,
    memory_of,
    nothing_offered,
    observe,
)

CLEAR_KW = 1_000.0
INTERVAL = 30


@dataclass
class Market:
    """A plant that promises what is offered, under a sky given as clear-sky indices."""

    settings: OfferSettings
    shares: list[float] = field(default_factory=list)
    kept: list[bool] = field(default_factory=list)

    def run(self, sky: np.ndarray) -> None:
        memory = memory_of(nothing_offered(self.settings), self.settings)
        share = coming = self.settings.first_share
        metered_kw, missed_kw = nan, 0.0
        for cycle, index in enumerate(sky):
            if cycle % INTERVAL == 0:
                share = coming
                self.shares.append(share)
            dispatch_kw = share * CLEAR_KW
            available_kw = index * CLEAR_KW
            # A limited inverter shows its maximum only where it is not curtailed.
            is_curtailed = available_kw > dispatch_kw and not self.settings.is_seen
            impp_kw = CLEAR_KW if is_curtailed else available_kw
            offered = observe(
                memory, self.settings, cycle, impp_kw, metered_kw, dispatch_kw, CLEAR_KW
            )
            coming = coming if isnan(offered) else offered
            metered_kw = min(dispatch_kw, available_kw)
            missed_kw += dispatch_kw - metered_kw
            if (cycle + 1) % INTERVAL == 0:
                self.kept.append(missed_kw <= MISSED_SHARE * dispatch_kw * INTERVAL)
                missed_kw = 0.0


def settings(*, is_seen: bool, reliability: float = 0.9) -> OfferSettings:
    return OfferSettings(INTERVAL, 3, 1, 180, 1.0 - reliability, 0.3, is_seen)


def broken_clouds(intervals: int, seed: int) -> np.ndarray:
    """A sky that drifts between dark and clear within some intervals."""
    noise = np.random.default_rng(seed).standard_normal(intervals * INTERVAL)
    walk = np.zeros_like(noise)
    for step in range(1, len(walk)):
        walk[step] = 0.995 * walk[step - 1] + 0.1 * noise[step]
    return 0.35 + 0.6 / (1.0 + np.exp(-2.0 * walk))


@pytest.mark.parametrize(("is_seen", "reliability"), [(True, 0.95), (False, 0.8)])
def test_offers_are_kept_as_often_as_asked_for(is_seen: bool, reliability: float) -> None:
    kept = []
    for seed in range(3):
        market = Market(settings(is_seen=is_seen, reliability=reliability))
        market.run(broken_clouds(600, seed))
        kept += market.kept
    assert np.mean(kept) == pytest.approx(reliability, abs=0.03)


def test_a_plant_that_is_held_back_offers_only_a_little_more_than_it_has_proven() -> None:
    market = Market(settings(is_seen=False))
    market.run(np.ones(20 * INTERVAL))
    assert all(
        later <= earlier * GROWTH * (1 + 1e-12)
        for earlier, later in zip(market.shares, market.shares[1:], strict=False)
    )
    assert market.shares[-1] > 0.6, "it comes to know a clear sky all the same"


def test_after_the_sky_has_darkened_offers_follow() -> None:
    market = Market(settings(is_seen=False))
    market.run(np.concatenate([np.full(60 * INTERVAL, 0.9), np.full(40 * INTERVAL, 0.4)]))
    assert market.shares[59] > 0.8
    assert np.median(market.shares[-20:]) <= 0.4 * (1 + MISSED_SHARE)
    assert np.mean(market.kept[-20:]) >= 0.8


@pytest.mark.parametrize("seed", range(5))
def test_the_firm_share_is_the_largest_of_which_one_per_cent_is_missing(seed: int) -> None:
    index = np.random.default_rng(seed).uniform(0.1, 1.1, 90)
    share = firm_share(index)
    missing = np.maximum(share - index, 0.0).sum() / (share * len(index))
    assert missing == pytest.approx(MISSED_SHARE)


def test_nothing_is_offered_between_the_times_for_it() -> None:
    own = settings(is_seen=True)
    memory = memory_of(nothing_offered(own), own)
    due = [
        cycle
        for cycle in range(4 * INTERVAL)
        if not isnan(observe(memory, own, cycle, 500.0, 300.0, 300.0, CLEAR_KW))
    ]
    assert due == [27, 57, 87, 117]


def test_at_night_nothing_is_learned_and_the_first_share_is_offered() -> None:
    own = settings(is_seen=True)
    memory = memory_of(nothing_offered(own), own)
    offers = [observe(memory, own, cycle, 0.0, 0.0, 0.0, 0.0) for cycle in range(2 * INTERVAL)]
    assert [share for share in offers if not isnan(share)] == [own.first_share] * 2
