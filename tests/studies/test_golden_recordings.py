"""The agents publish what they published when the golden recordings were made.

If a change of behaviour is meant: `make golden`.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace
from record_golden import record_again
from recorded_runs import cloudy_profile, plan_of, published, record

from bus_schemas.tree import PLANT
from recordings.read.run_file import RECORDING_NAME
from recordings.verify.comparison import BIT_FOR_BIT, Equality
from recordings.verify.verification import verify
from sim_plant.profile import PROFILE_NAME

GOLDEN = Path(__file__).parents[2] / "recordings" / "golden"
RUNS = sorted(path for path in GOLDEN.iterdir() if path.is_dir())

ROUNDED = Equality(1e-6)
"""The plant's sums over inverters are numpy's, whose order of adding is not promised."""


@pytest.mark.parametrize("run", RUNS, ids=lambda path: path.name)
@pytest.mark.parametrize(
    ("nodes", "equality"),
    [("central/*", BIT_FOR_BIT), (PLANT, ROUNDED)],
    ids=["controllers", "plant"],
)
def test_agents_publish_what_the_golden_recording_has(
    run: Path, nodes: str, equality: Equality
) -> None:
    verification = verify(run, nodes, equality)
    assert verification.equal, verification.first
    assert (PLANT in verification.agents) == (nodes == PLANT)
    assert len(verification.agents) > 20 or nodes == PLANT


def test_a_run_recorded_again_has_todays_behaviour_and_its_own_sky(tmp_path: Path) -> None:
    plan = plan_of(cycles=8)
    profile = cloudy_profile(plan)
    messages = [
        (port, replace(message, alpha=0.0625) if place == ("c2/d/command", 3) else message)
        for port, message in published(plan, profile)
        for place in [(str(port), message.cycle)]
    ]
    run = record(tmp_path / "run", plan, messages, profile)
    before = (run / PROFILE_NAME).read_bytes()
    assert not verify(run).equal
    record_again(run)
    assert verify(run).equal
    assert (run / PROFILE_NAME).read_bytes() == before
    assert sorted(path.name for path in run.iterdir()) == [PROFILE_NAME, RECORDING_NAME]
