"""What is left of a recording when its recorder is killed, or its disk is full."""

from __future__ import annotations

import random
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from command_line import python
from running import Heliarch, Start
from verifying import first_differences

from bus_schemas.signals import PRODUCTION
from heliarch.cli.export import export
from recordings.inspect.overview import read_overview
from recordings.read.reader import RunReader
from recordings.record.recorder import FLUSH_S
from recordings.verify.verification import verify

pytestmark = pytest.mark.processes


COPY = "run.recovered.mcap"

LATENESS_S = 1.0
"""What a machine that does nothing else may add to the time between two flushes."""


def kill_recorder(run: Heliarch) -> float:
    """Kill the recorder of a run some time after its first flush, and copy what it left.

    Returns the time between the last message that was kept and the kill [s].
    """
    phase_s = random.uniform(0.0, 2.0 * FLUSH_S)
    run.until_recorded()
    recorder = run.process_of("recorder")
    time.sleep(phase_s)
    flushed_cycles = run.recorded_cycles()
    killed_at_ns = time.monotonic_ns()
    recorder.send_signal(signal.SIGKILL)
    assert run.wait() == 1
    export(run.folder, form="mcap")
    last_ns = cycles = 0
    with RunReader(run.folder) as before, RunReader(run.folder / COPY) as after:
        assert (before.whole, after.whole) == (False, True)
        assert (before.plan, before.scenario) == (after.plan, after.scenario)
        for cut, kept in zip(before.records(), after.records(), strict=True):
            assert cut == kept, "byte for byte, with its times, number and place"
        for port, message in after.messages():
            if message.publish_time_ns < killed_at_ns:  # A new recorder wrote the later ones.
                last_ns = max(last_ns, message.publish_time_ns)
            cycles += port.signal is PRODUCTION
    assert cycles >= flushed_cycles > 0, f"killed {phase_s:.3f} s after a flush"
    return (killed_at_ns - last_ns) / 1e9


@pytest.mark.parametrize("pace", [("--pace", "10"), ("--set", "restart.when=on-failure")])
def test_a_recorder_is_started_again_and_all_its_files_are_one_recording(
    heliarch: Start, plant: str, pace: tuple[str, ...]
) -> None:
    words = ("--duration", "10h", "--set", "restart.frozen_s=1.5", *pace)
    run = heliarch("launch", plant, *words)
    run.until_recorded()
    run.process_of("recorder").send_signal(signal.SIGKILL)
    run.until((run.folder / "run-2.mcap").exists, "its next file")
    run.until_recorded(run.recorded_cycles() + 5)
    run.process_of("recorder").send_signal(signal.SIGSTOP)
    run.until((run.folder / "run-3.mcap").exists, "its third file")
    run.until_recorded(run.recorded_cycles() + 5)
    assert run.interrupt() == 1
    assert "messages were lost" in run.error_text()
    summary = msgspec.json.decode((run.folder / "summary.json").read_bytes())
    assert summary["restarts"] == {"recorder": 2}
    with RunReader(run.folder) as reader:
        health = read_overview(reader)
        recorded = [message.cycle for _, message in reader.messages(PRODUCTION)]
        assert reader.stop_cycle is not None
        assert reader.last_cycle == recorded[-1] == reader.stop_cycle - 1
    # Of the last messages on a key nothing in the recording tells.
    assert 0 < health.messages_lost <= summary["messages_lost"]
    assert recorded == sorted(set(recorded))
    assert summary["cycles"] == reader.stop_cycle > len(recorded)
    assert summary["cycles_per_s"] == pytest.approx(summary["cycles"] / summary["wall_s"])
    found = verify(run.folder)
    assert first_differences(found) == {}
    assert not found.equal, "not all could be compared"
    assert 0.0 < found.share < 1.0


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_twenty_kills_at_random_moments(
    heliarch: Start, plant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Measures what is lost, on a machine that does nothing else."""
    lost_s = sorted(kill_recorder(heliarch("launch", plant)) for _ in range(20))
    with capsys.disabled():
        print(f"\nlost of {len(lost_s)} recordings [s]: " + ", ".join(f"{s:.3f}" for s in lost_s))
        print(f"worst loss: {lost_s[-1]:.3f} s, flushed every {FLUSH_S:g} s")
    assert lost_s[-1] <= FLUSH_S + LATENESS_S


@pytest.mark.skipif(sys.platform != "linux", reason="limits a process from outside: Linux only")
def test_a_full_disk_ends_the_recording_and_not_the_plant(heliarch: Start, plant: str) -> None:
    run = heliarch("launch", plant, "--duration", "15m")
    run.until_recorded()
    full = (run.folder / "run.mcap").stat().st_size + 20_000
    resource.prlimit(run.process_of("recorder").pid, resource.RLIMIT_FSIZE, (full, full))
    assert run.wait() == 1
    said = run.output.read_text()
    assert re.search(r"the recording ended in cycle \d+: .*; the run goes on without it", said)
    assert re.search("heliarch: the recording ended in cycle .*", run.error_text())
    summary = msgspec.json.decode((run.folder / "summary.json").read_bytes())
    assert summary["cycles"] == 900
    recorded = sum(count["recorded"] for count in summary["messages"])
    with RunReader(run.folder) as reader:
        assert not reader.whole
        assert 0 < recorded == sum(1 for _ in reader.messages())
    assert 0 < run.recorded_cycles() < 900


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "none", str(disk)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no small disk can be mounted here: only root may")
    yield disk
    subprocess.run(["umount", "--lazy", str(disk)], check=True)


def test_a_full_disk_costs_neither_figures_nor_counts(
    small_disk: Path, plant: str, tmp_path: Path
) -> None:
    words = ("simulate", plant, "--duration", "3h", "--out", str(small_disk / "run"))
    command = [sys.executable, "-m", "heliarch", *words]
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert run.returncode == 1
    assert "No space left on device" in run.stderr
    assert "Traceback" not in run.stderr
    for row in ("RMSE", "Messages"):
        assert re.search(rf"{row}.*\d", run.stdout), f"{row}: {run.stdout}"
    assert re.search(r"Missing +[1-9][\d,]* messages not recorded", run.stdout)


def test_a_full_disk_costs_a_program_no_figures(small_disk: Path, plant: str) -> None:
    code = """
import sys, heliarch
run = heliarch.simulate(sys.argv[1], duration="3h", out=sys.argv[2])
print(run.metrics["rmse"] > 0.0)
"""
    done = python(code, plant, small_disk / "run")
    assert done.stdout.strip() == "True", done.stderr
    assert "summary.json" in done.stderr
