"""Random kills on real processes, for long: what they leave behind. `make soak`."""

from __future__ import annotations

import os
import random
import re
import signal
from collections import Counter
from itertools import count
from pathlib import Path
from typing import NamedTuple

import msgspec
import psutil
import pytest
from running import Heliarch, Start, small_plant
from verifying import first_differences

from agents.plan import load_plan
from bus_schemas.tree import PLANT, RECORDER
from recordings.verify.verification import verify

pytestmark = [pytest.mark.processes, pytest.mark.soak]

SOAK_S = int(os.environ.get("SOAK_S", "1800"))
RATE = 5
CYCLES_BETWEEN_KILLS = 10 * RATE


class Use(NamedTuple):
    """What a process has taken of the machine."""

    files: int
    threads: int
    own_mb: float


def use_of(process: psutil.Process) -> Use:
    with process.oneshot():
        own_mb = process.memory_full_info().uss / 1e6
        return Use(process.num_fds(), process.num_threads(), own_mb)


def until_cycle(run: Heliarch, cycle: int) -> None:
    shown = re.compile(r"cycle (\d+)/")
    run.until(lambda: int(shown.findall(run.output.read_text())[-1]) >= cycle, f"cycle {cycle}")


@pytest.mark.timeout(SOAK_S + 900)
def test_a_kill_every_ten_seconds_leaves_no_orphan_no_leak_and_nothing_unaccounted_for(
    heliarch: Start, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seed = random.randrange(2**32)
    drawn, cycles = random.Random(seed), SOAK_S * RATE
    scenario = small_plant(tmp_path / "plant", ("duration_s = 3600", f"duration_s = {cycles}"))
    options = ('standby=["central","supervisors"]', "restart.when=always")
    words = [word for option in options for word in ("--set", option)]
    run = heliarch("launch", scenario, "--pace", str(RATE), *words)
    run.until_running()
    victims = [
        name
        for name in load_plan(run.folder / "plan.json").processes
        if name not in {PLANT, RECORDER}
    ]
    lasting = {
        "launcher": psutil.Process(run.process.pid),
        "fork server": run.fork_server(),
        **{name: run.process_of(name) for name in (PLANT, RECORDER)},
    }
    kills: Counter[str] = Counter()
    uses: dict[str, list[Use]] = {name: [] for name in lasting}
    for cycle in count(CYCLES_BETWEEN_KILLS, CYCLES_BETWEEN_KILLS):
        if cycle > cycles - CYCLES_BETWEEN_KILLS:
            break
        until_cycle(run, cycle)
        for name, process in lasting.items():
            uses[name].append(use_of(process))
        victim = drawn.choice(victims)
        run.process_of(victim).send_signal(signal.SIGKILL)
        kills[victim] += 1
    assert run.wait() == 0, run.error_text()
    summary = msgspec.json.decode((run.folder / "summary.json").read_bytes())
    with capsys.disabled():
        print(f"\nseed {seed}: {kills.total()} kills in {cycles:,} cycles, {uses}")
    assert summary["launcher"]["restarts"] == kills
    assert summary["cycles"] == cycles
    assert summary["messages_lost"] == 0
    assert set(summary["launcher"]["dropped"]) <= {"wrong_sender", "duplicate", "late"}
    for name, found in uses.items():
        early, late = found[1 : 2 + len(found) // 3], found[-len(found) // 3 :]
        assert max(use.files for use in late) <= max(use.files for use in early), name
        assert max(use.threads for use in late) <= max(use.threads for use in early), name
        # A recorder keeps what its file's index will say: some 6 kB a second.
        growth_mb = 8e-3 * SOAK_S if name == RECORDER else 0.0
        assert late[-1].own_mb <= early[-1].own_mb + 2.0 + growth_mb, name
    found_again = verify(run.folder)
    assert first_differences(found_again) == {}
    assert found_again.equal


@pytest.mark.timeout(900)
def test_a_thousand_inverters_start_again_and_again(heliarch: Start) -> None:
    for _ in range(3):
        run = heliarch("launch", "thousand", "--duration", "1m")
        assert run.wait() == 0
        summary = msgspec.json.decode((run.folder / "summary.json").read_bytes())
        assert (summary["cycles"], summary["messages_lost"]) == (6, 0)
