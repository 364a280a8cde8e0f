"""What processes counted and took is added up by tier."""

from __future__ import annotations

from collections import Counter

import pytest
from timed_recordings import PLAN

from launch_scripts.launcher.summary import ProcessAccount
from studies.timing.run_timing import AgentTiming
from studies.timing.tiers import tier_accounts


def test_counts_and_shares_are_added_up_by_tier() -> None:
    agents = {
        "plant": AgentTiming(),
        "c1/a": AgentTiming(
            Counter(estimate=2, actuate=1), Counter({"dispatch": 4}), Counter(actuate=1), 2, 1
        ),
        "c2/d": AgentTiming(Counter(estimate=1), skipped_cycles=3),
    }
    accounts = [
        ProcessAccount("c1/a", "direct", {"late": 4}, 40.0, cpu_s=2.0),
        ProcessAccount("c2/d", "direct", {"late": 1}, 42.0, cpu_s=5.0),
    ]
    plant, direct = tier_accounts(agents, accounts, 10.0, PLAN.tree)
    assert (plant.tier, plant.processes, plant.missed_deadlines) == ("plant", 1, 0)
    assert (direct.processes, direct.missed_deadlines, direct.overruns) == (2, 4, 1)
    assert (direct.missing_inputs, direct.old_inputs, direct.skipped_cycles) == (4, 2, 4)
    assert (direct.dropped, direct.resident_mb) == (5, 42.0)
    assert direct.cpu_percent == pytest.approx(70.0)
    assert direct.cpu_highest_percent == pytest.approx(50.0)


def test_what_is_not_known_is_none() -> None:
    (plant,) = tier_accounts({"plant": AgentTiming()}, (), 10.0, PLAN.tree)
    assert (plant.dropped, plant.cpu_percent, plant.resident_mb) == (None, None, None)


def test_the_recorder_has_a_share_and_no_stages() -> None:
    recorder = ProcessAccount("recorder", "recorder", {}, 50.0, cpu_s=1.25)
    (found,) = tier_accounts({}, [recorder], 10.0, PLAN.tree)
    assert (found.tier, found.processes, found.missed_deadlines) == ("recorder", 1, 0)
    assert (found.cpu_percent, found.resident_mb) == (12.5, 50.0)
