"""Counts and resources are joined for each process and added up for each tier."""

from __future__ import annotations

import pytest
from timed_recordings import PLAN

from launch_scripts.launcher.summary import ProcessAccount
from studies.timing.measures import ProcessTiming, tier_timings, with_accounts


def test_counts_and_resources_are_added_up_by_tier() -> None:
    processes = [
        ProcessTiming(agent="plant", tier="plant", kind="plant"),
        ProcessTiming(
            agent="c1/a",
            tier="direct",
            kind="direct",
            missed_deadlines={"estimate": 2, "actuate": 1},
            missing_inputs={"dispatch": 4},
            overruns={"actuate": 1},
            old_inputs=2,
            skipped_cycles=1,
        ),
        ProcessTiming(
            agent="c2/d",
            tier="direct",
            kind="direct",
            missed_deadlines={"estimate": 1},
            skipped_cycles=3,
        ),
    ]
    accounts = [
        ProcessAccount("c1/a", "direct", {"late": 4}, 40.0, cpu_s=2.0),
        ProcessAccount("c2/d", "direct", {"late": 1}, 42.0, cpu_s=5.0),
        ProcessAccount("recorder", "recorder", {}, 50.0, cpu_s=1.25),
    ]
    found = tier_timings(with_accounts(processes, accounts, 10.0, PLAN.tree))
    tiers = {tier.tier: tier for tier in found}
    recorder, plant, direct = tiers["recorder"], tiers["plant"], tiers["direct"]
    assert (plant.processes, plant.missed_deadlines) == (1, 0)
    # Nobody but the launcher knows these.
    assert (plant.dropped, plant.cpu_percent, plant.resident_mb) == (None, None, None)
    assert (direct.processes, direct.missed_deadlines, direct.overruns) == (2, 4, 1)
    assert (direct.missing_inputs, direct.old_inputs, direct.skipped_cycles) == (4, 2, 4)
    assert (direct.dropped, direct.resident_mb) == (5, 42.0)
    assert direct.cpu_percent == pytest.approx(70.0)
    assert direct.cpu_highest_percent == pytest.approx(50.0)
    assert (recorder.processes, recorder.missed_deadlines) == (1, 0)
    assert (recorder.cpu_percent, recorder.resident_mb) == (12.5, 50.0)
