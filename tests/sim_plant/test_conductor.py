"""Arming rounds have more and more time, and are all over before the plant gives up."""

from __future__ import annotations

from itertools import pairwise

from sim_plant.conductor import longest_round_s


def test_arming_rounds_become_longer_up_to_three_seconds() -> None:
    rounds_s = [longest_round_s(number) for number in range(1, 100)]
    assert rounds_s[0] == 0.3
    assert all(earlier <= later for earlier, later in pairwise(rounds_s))
    assert longest_round_s(1_000_000) == rounds_s[-1] == 3.0


def test_several_of_the_longest_are_tried_within_half_a_minute() -> None:
    rounds_s = [longest_round_s(number) for number in range(1, 100)]
    within = [sum(rounds_s[:number]) for number in range(100)]
    tried = sum(1 for began_s in within if began_s < 30.0)
    assert rounds_s[:tried].count(3.0) >= 5
