"""The agents publish what they published when the golden recordings were made.

If a change of behaviour is meant: `heliarch verify --accept recordings/golden/*/`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from bus_schemas.tree import PLANT
from recordings.verify.comparison import BIT_FOR_BIT, Equality
from recordings.verify.verification import verify

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
