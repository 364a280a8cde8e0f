"""One run on two hosts: `heliarch node` starts the agents of the second, whatever its clock."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import psutil
import pytest
from command_line import done
from running import REPOSITORY, Heliarch, Start
from test_external import our_decisions
from test_launch import decisions, summary_of
from test_restarts import GROUPED

from recordings.verify.verification import verify
from results.timing.report import report_on

pytestmark = pytest.mark.processes


SECOND = "127.0.0.2"
"""On one machine, another address of the loopback interface stands for another host."""


@pytest.fixture
def secure(plant: str, tmp_path: Path) -> tuple[str, ...]:
    """Options of a run with keys for both hosts."""
    pytest.importorskip("cryptography")
    done("keys", plant, "--address", SECOND, "--out", str(tmp_path / "keys"))
    return ("--secure", "--keys", str(tmp_path / "keys"))


def node(heliarch: Start, run: Heliarch, host: str) -> Heliarch:
    """Start the other host's share of a run that is launched."""
    plan = run.folder / "plan.json"
    run.until(plan.exists, "a plan")
    keys = str(run.folder.parent / "keys")
    return heliarch("node", "--plan", str(plan), "--host", host, "--keys", keys)


@pytest.mark.parametrize(
    ("grouped", "logs"), [((), {"c2", "c2.inv03", "c2.inv04"}), (GROUPED, {"c2"})]
)
def test_the_agents_of_two_hosts_decide_what_those_of_one_decide(
    heliarch: Start,
    plant: str,
    secure: tuple[str, ...],
    grouped: Sequence[str],
    logs: set[str],
) -> None:
    lockstep = ("--duration", "25", "--seed", "3", "--scheme", "paper", *grouped, *secure)
    run = heliarch("launch", plant, *lockstep, "--on", f"{SECOND}=c2/*")
    other = node(heliarch, run, SECOND)
    assert run.wait() == 0, run.error_text()
    assert other.wait() == 0, other.error_text()
    assert {path.stem for path in (other.folder / "logs").iterdir()} == logs
    assert decisions(run.folder) == our_decisions(plant)
    found = verify(run.folder)
    assert found.equal
    assert not found.left_out
    summary = summary_of(run.folder)
    assert (summary.lost, summary.wrong) == (0, ())


def test_processes_that_freeze_or_die_on_another_host_are_started_again_there(
    heliarch: Start, plant: str, secure: tuple[str, ...]
) -> None:
    settings = ("--set", "restart.frozen_s=2")
    words = ("--duration", "1h", "--pace", "2", *settings, *secure)
    run = heliarch("launch", plant, *words, "--on", f"{SECOND}=c2/*")
    other = node(heliarch, run, SECOND)
    run.until_running()
    other.process_of("c2/inv03").send_signal(signal.SIGSTOP)
    run.until_shown(f"c2/inv03 ({SECOND}) is back in cycle")
    other.process_of("c2").send_signal(signal.SIGKILL)
    run.until_shown(f"c2 ({SECOND}) is back in cycle")
    run.interrupt()
    assert other.wait() == 0, other.error_text()
    said = other.output.read_text()
    assert "c2/inv03 (process" in said
    assert "c2 (process" in said
    assert "c2/inv04 (process" not in said, "nobody else is killed"
    log = (other.folder / "logs" / "c2.inv04.log").read_text()
    assert "did not say that the run is over" not in log, "nobody waits in vain for its end"
    summary = summary_of(run.folder)
    assert summary.lost_by_processes == 0


def test_agents_end_when_the_plant_disappears_also_while_their_node_stands_still(
    heliarch: Start, plant: str, secure: tuple[str, ...]
) -> None:
    run = heliarch("launch", plant, "--duration", "12h", *secure, "--on", f"{SECOND}=c2/*")
    other = node(heliarch, run, SECOND)
    run.until_running()
    agents = [other.process_of(name) for name in ("c2", "c2/inv03", "c2/inv04")]
    other.process.send_signal(signal.SIGSTOP)
    run.process.kill()
    _, alive = psutil.wait_procs(agents, timeout=60)
    assert not alive
    other.process.send_signal(signal.SIGCONT)
    assert other.wait() == 1


def test_a_host_with_keys_and_another_clock(heliarch: Start, plant: str, tmp_path: Path) -> None:
    if os.geteuid() or not shutil.which("unshare"):
        pytest.skip("another clock needs root and util-linux")
    pytest.importorskip("cryptography")
    keys, keys_there = tmp_path / "keys", tmp_path / "keys-there"
    done("keys", plant, "--address", "127.0.0.1", "--address", SECOND, "--out", keys)
    keys_there.mkdir()
    for path in (keys / "ca.pem", *keys.glob("c2.*")):
        shutil.copy(path, keys_there)
    words = ("--duration", "20", "--pace", "4", "--secure", "--keys", keys, "--on")
    run = heliarch("launch", plant, *words, f"{SECOND}=c2/*")
    run.until((run.folder / "plan.json").exists, "a plan")
    later = ("unshare", "--time", "--monotonic", "1000000", "--fork", "--kill-child")
    share = ("--plan", run.folder / "plan.json", "--host", SECOND, "--keys", keys_there)
    node_words = [sys.executable, "-m", "heliarch", "node", *share, "--out", tmp_path / "node"]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    with subprocess.Popen([*later, *map(str, node_words)], env=environment) as other:
        assert (run.wait(), other.wait(60)) == (0, 0), run.error_text()
    logs = [path.read_text() for path in (tmp_path / "node" / "logs").glob("*.log")]
    assert any("clock is ahead by 10000" in log for log in logs)
    report = report_on(run.folder)
    (clock,) = report.clocks
    assert clock.host == SECOND
    assert abs(clock.offset_ms) <= clock.uncertainty_ms + 1.0, (
        "its agents took the time of the plant"
    )
    # Each host has a clock of its own: no hop between the two is measured, but the loop is.
    assert "loop" in set(report.times.measure)
    links = [one.split(" to ") for one in report.times[report.times.by == "link"]["of"]]
    assert links
    assert all(key.startswith("c2/") == f"{there}/".startswith("c2/") for key, there in links)
    assert verify(run.folder).equal
