"""Programs that do not belong on the bus change nothing; what they say is named and counted."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import done
from running import Heliarch, Start
from test_external import NODE
from test_launch import summary_of

from agents.plan_file import load_plan
from results.run_document import RunDocument

pytestmark = pytest.mark.processes

LONG = "5h"
"""Plant time: in lockstep longer than any attack."""


def ended(run: Heliarch) -> RunDocument:
    """End a run with Ctrl-C."""
    run.interrupt()
    return summary_of(run.folder)


def test_a_run_without_devices_listens_where_no_other_user_can_come(
    heliarch: Start, plant: str
) -> None:
    run = heliarch("launch", plant, "--duration", LONG)
    run.until_running()
    plan = load_plan(run.folder / "plan.json")
    assert (run.folder / "plan.json").stat().st_mode & 0o077 == 0, "it is for its user alone"
    assert Path(plan.access.sockets).stat().st_mode & 0o077 == 0
    links = [link for one in run.processes() for link in one.net_connections("inet")]
    assert links == []
    ended(run)
    assert not Path(plan.access.sockets).exists()


def test_a_process_that_is_started_again_reads_renewed_certificates(
    heliarch: Start, plant: str, tmp_path: Path
) -> None:
    pytest.importorskip("cryptography")
    keys = str(tmp_path / "keys")
    done("keys", plant, "--out", keys)
    words = ("--duration", "1h", "--pace", "5", "--secure", "--keys", keys)
    run = heliarch("launch", plant, *words)
    run.until_running()
    done("keys", plant, "--out", keys, "--days", "0.0000001")
    run.process_of(NODE).kill()
    run.until_recorded(run.recorded_cycles() + 20)
    assert run.incarnations(NODE) == {0}
    done("keys", plant, "--out", keys)
    run.until_back(NODE)
    run.process_of("c1").kill()
    run.until_back("c1")
    assert ended(run).wrong == ()
