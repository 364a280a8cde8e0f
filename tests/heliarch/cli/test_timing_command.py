"""`heliarch timing` refuses what it cannot do before it runs, and reports on recorded runs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import heliarch, refusal
from junitparser import JUnitXml
from msgspec.structs import replace
from plans_by_hand import with_changes
from reports_by_hand import missed, summary_of
from timed_recordings import PLAN, cycle, recorded


def test_a_run_that_was_recorded_earlier_is_timed_without_running_anything(tmp_path: Path) -> None:
    folder = recorded(tmp_path, cycle(0), missed(1))
    (folder / "summary.json").write_bytes(summary_of(folder).as_json())
    document = tmp_path / "x.json"
    run = folder / "run.mcap"
    result = heliarch("timing", run, "--json", document, "--report")
    assert result.exit_code == 1, result.output
    assert "not kept: late cycles 50.00 % (at most 1.00 %)" in result.stdout
    found = json.loads(document.read_bytes())
    assert (found["run"]["cycles"], found["run"]["lost_messages"]) == (2, 0)
    (late,) = found["late_cycles"]
    assert (late["cycle"], late["culprit"], late["cause"]) == (1, "c2/d", "published nothing")
    stages = tmp_path / "stages.csv"
    assert heliarch("timing", run, "--stages", stages, "--by", "link").exit_code == 1
    assert stages.read_text().startswith("cycle,agent,tier,stage,")
    junit = tmp_path / "timing.xml"
    assert heliarch("timing", run, "--junit", junit).exit_code == 1
    (suite,) = JUnitXml.fromfile(str(junit))
    budgets = {budget["line"]: budget["passed"] for budget in found["budgets"]}
    assert {case.name: not case.result for case in suite} == budgets
    assert "--stages" in refusal("timing", run, "--stages", tmp_path / "stages.txt")
    assert "FAIL: " in (folder / "timing.html").read_text(encoding="utf-8")
    (tmp_path / "lockstep").mkdir()
    run = recorded(tmp_path / "lockstep", cycle(0), plan=with_changes(PLAN, cycle_wall_ns=0))
    assert "real time" in refusal("timing", run)


@pytest.mark.parametrize(
    ("lost", "interrupted", "ended", "status"),
    [(0, False, True, 0), (1, False, True, 1), (0, True, True, 130), (0, False, False, 1)],
)
def test_the_exit_status_tells_kept_not_kept_and_interrupted(
    lost: int, interrupted: bool, ended: bool, status: int, tmp_path: Path
) -> None:
    folder = recorded(tmp_path, cycle(0), cycle(1), ended=ended)
    summary = summary_of(folder, lost=lost)
    summary = replace(summary, interrupted=interrupted)
    (folder / "summary.json").write_bytes(summary.as_json())
    assert heliarch("timing", folder).exit_code == status
