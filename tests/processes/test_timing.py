"""`heliarch timing` on a plant of real processes: every row is there, and nothing is left over."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import command_line
import pandas as pd
import pytest
from running import assert_none_left, small_plant

from heliarch import open_run

pytestmark = pytest.mark.processes


STAGES = {
    "plant": {"sense", "apply"},
    "central": {"solve"},
    "supervisor": {"report", "solve"},
    "direct": {"estimate", "actuate"},
}
CYCLES = 20

IMPOSSIBLE = """\
[timing.budgets]
loop_p99_ms = 0.001
late_cycles_percent = 100
"""


def test_a_timed_run_has_all_rows_and_the_budget_that_it_broke(tmp_path: Path) -> None:
    scenario = small_plant(tmp_path / "plant", ("[neighbours]", f"{IMPOSSIBLE}\n[neighbours]"))
    folder = tmp_path / "run"
    words = ("--rate", "10", "--duration", f"{CYCLES / 10:g}s", "--json", "-", "--report")
    stages = tmp_path / "stages.parquet"
    result = command_line.heliarch("timing", scenario, *words, "--stages", stages, "--out", folder)
    assert result.exit_code == 1, result.output
    report: dict[str, Any] = json.loads(result.stdout)

    rows = {(row["measure"], row["of"]): row for row in report["times"] if row["by"] == "tier"}
    decided = {of for measure, of in rows if measure == "decision"}
    assert decided == {f"{tier} {stage}" for tier in STAGES for stage in STAGES[tier]}
    assert {measure for measure, _ in rows} >= {"loop", "lateness", "age", "hop", "gap sent"}
    assert {row["by"] for row in report["times"]} == {"tier", "agent", "link"}
    assert {one["cycle"] for one in report["late_cycles"]} <= set(range(CYCLES))
    assert len(report["late_cycles"]) == report["run"]["late_cycles"]
    assert rows["loop", "all commands"]["count"] == CYCLES
    assert {row["min_ms"] >= 0 for row in report["times"]} == {True}
    assert [tier["tier"] for tier in report["tiers"]] == [*STAGES, "recorder"]
    (recorder,) = [tier for tier in report["tiers"] if tier["tier"] == "recorder"]
    assert 0.0 < recorder["cpu_percent"] < 100.0 * (os.cpu_count() or 1)
    (failed,) = [v for v in report["budgets"] if v["line"] == "loop all commands p99"]
    assert (failed["passed"], report["passed"]) == (False, False)
    assert "loop all commands p99" in result.stderr
    assert (folder / "timing.html").exists()
    table = open_run(folder).stages()
    written = pd.read_parquet(stages)
    assert len(written) == len(table) > CYCLES * len(STAGES)
    assert list(written) == list(table)
    assert written.published.tolist() == pytest.approx(table.published.tolist(), nan_ok=True)
    assert written.stopped.notna().all()
    assert_none_left(folder)
