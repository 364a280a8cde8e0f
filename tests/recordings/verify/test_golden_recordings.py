"""The agents say what they said when the golden recordings were made.

If a change of behaviour is meant: `heliarch verify --accept recordings/golden/*/`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from bus_schemas.tree import PLANT, agent_name
from recordings.read.reader import RunReader
from recordings.verify.comparison import Comparison
from recordings.verify.verification import verify

GOLDEN = Path(__file__).parents[3] / "recordings" / "golden"
RUNS = sorted(path for path in GOLDEN.iterdir() if path.is_dir())

SUM_TOLERANCE_KW = 1e-6
"""The plant's sums over inverters are numpy's, whose order of adding is not promised."""


@pytest.mark.parametrize("run", RUNS, ids=lambda path: path.name)
def test_controllers_say_the_same_bits_as_in_the_golden_recording(run: Path) -> None:
    with RunReader(run) as reader:
        names = [agent_name(path) for path in reader.plan.tree.nodes]
    found = verify(run, names, Comparison())
    assert found.equal, found.first
    assert tuple(found.agents) == tuple(names)


@pytest.mark.parametrize("run", RUNS, ids=lambda path: path.name)
def test_the_plant_does_the_same_as_in_the_golden_recording(run: Path) -> None:
    found = verify(run, [PLANT], Comparison(SUM_TOLERANCE_KW))
    assert found.equal, found.first
