"""Random kills and cuts on real processes, for long: what they leave behind. `make soak`."""

from __future__ import annotations

import os
import random
import re
import shutil
import signal
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from statistics import median
from typing import NamedTuple, TextIO

import msgspec
import psutil
import pytest
from cut_network import Network, network_of_its_own, over_tcp
from running import REPOSITORY, Heliarch, Start, commands_in, small_plant
from verifying import assert_equal_as_far_as_recorded

from agents.plan_file import load_plan
from bus_schemas.tree import PLANT, RECORDER
from recordings.inspect.overview import read_through
from recordings.read.reader import RunReader
from recordings.read.run_file import RECORDING_NAME, further_files
from recordings.verify.verification import verify

pytestmark = [pytest.mark.processes, pytest.mark.soak]

SOAK_S = int(os.environ.get("SOAK_S", "1800"))
RATE = 5
BETWEEN_FAULTS = 5 * RATE
LONGEST_CUT_S = 4.0
SETTLED_MB = 15.0
"""What plant and recorder come to once each of their buffers has been in use: in the first minutes
a recorder grows from 10 to 14.5 MB, and then no more."""


DAYS_CYCLES = int(os.environ.get("DAYS_CYCLES", "17280"))
"""Of 10 s: two days."""
FILES = 48
KEPT_FILES = 6
SAMPLES = 16 * min(25, DAYS_CYCLES // 80)
MOST_GROWTH, MOST_GROWTH_MB = 0.05, 1.0
FILLED_MB = 400.0
"""A recorder of `thousand` grows until all buffers of its links and its queue have been in use: to
330 to 338 MB in four lives of up to 4,300 cycles."""


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
    shown = re.compile(r"(\d+) of \d+ cycles")
    run.until(lambda: int(shown.findall(run.output.read_text())[-1]) >= cycle, f"cycle {cycle}")


@pytest.fixture
def network() -> Iterator[Network]:
    with network_of_its_own() as found:
        yield found


@pytest.mark.timeout(SOAK_S + 900)
def test_a_kill_or_a_cut_every_five_seconds_leaves_no_orphan_no_leak_and_nothing_unaccounted_for(
    network: Network, capsys: pytest.CaptureFixture[str]
) -> None:
    seed, cycles = random.randrange(2**32), SOAK_S * RATE
    folder = REPOSITORY / "build" / f"soak-{seed}"  # It stays if the test fails.
    folder.mkdir(parents=True)
    scenario = small_plant(folder, ("duration_s = 3600", f"duration_s = {cycles}"))
    words = ("--set", "restart.when=always", *over_tcp(str(scenario), folder / "keys"))
    with commands_in(folder) as start, (folder / "faults.txt").open("w") as faults:
        run = start("launch", scenario, "--pace", str(RATE), *words, network=network.name)
        kills, uses = attack(run, network, random.Random(seed), cycles, faults)
        run.wait()
    summary = msgspec.json.decode((run.folder / "summary.json").read_bytes())
    ended = re.findall(r"^.*(?:: killed|gave up|ended \().*$", run.output.read_text(), re.MULTILINE)
    found_again = verify(run.folder)
    compared, of = found_again.total("compared"), found_again.asked
    with capsys.disabled():
        print(f"\n{folder.name}: {kills.total()} kills in {cycles:,} cycles")
        print(
            f"{compared:,} of {of:,} messages compared, {summary['messages_lost']:,} not recorded"
        )
        for name, found in uses.items():
            print(f"{name}: {found[0]}, then {found[len(found) // 3]}, at last {found[-1]}")
    assert ended == []
    assert summary["restarts"] == kills
    assert summary["given_up"] == {}
    assert summary["cycles"] == cycles
    assert set(summary["dropped"]) <= {"wrong_sender", "duplicate", "late"}
    for name, found in uses.items():
        early, late = found[1 : 2 + len(found) // 3], found[-len(found) // 3 :]
        # A file that is open for a moment is none that leaks.
        assert min(use.files for use in late) <= max(use.files for use in early), name
        assert min(use.threads for use in late) <= max(use.threads for use in early), name
        assert late[-1].own_mb <= max(early[-1].own_mb + 2.0, SETTLED_MB), name
    assert_equal_as_far_as_recorded(run, found_again)
    shutil.rmtree(folder)


def attack(
    run: Heliarch, network: Network, drawn: random.Random, cycles: int, faults: TextIO
) -> tuple[Counter[str], dict[str, list[Use]]]:
    """Kill or cut off a process every five seconds, and write down which.

    Returns how often each was killed, and what the lasting processes took of the machine.
    """
    run.until_running()
    processes = load_plan(run.folder / "plan.json").processes
    victims = [name for name in processes if name not in {PLANT, RECORDER}]
    lasting = {
        "launcher": psutil.Process(run.process.pid),
        "fork server": run.fork_server(),
        **{name: run.process_of(name) for name in (PLANT, RECORDER)},
    }
    kills = Counter[str]()
    uses: dict[str, list[Use]] = {name: [] for name in lasting}
    for cycle in range(BETWEEN_FAULTS, cycles - 2 * BETWEEN_FAULTS, BETWEEN_FAULTS):
        until_cycle(run, cycle)
        for name, process in lasting.items():
            uses[name].append(use_of(process))
        used = " ".join(f"{found[-1].own_mb:.2f}" for found in uses.values())
        if drawn.random() < 0.5:
            victim = drawn.choice(victims)
            faults.write(f"{cycle} kill {victim}, MB {used}\n")
            run.process_of(victim).send_signal(signal.SIGKILL)
            kills[victim] += 1
        else:
            victim, length_s = drawn.choice(processes), drawn.uniform(0.5, LONGEST_CUT_S)
            faults.write(f"{cycle} cut {victim} for {length_s:.1f} s, MB {used}\n")
            network.cut_links(run.process_of(victim).pid)
            time.sleep(length_s)
            network.heal()
        faults.flush()
    return kills, uses


@pytest.mark.timeout(DAYS_CYCLES + 900)
def test_two_days_of_kills_and_deleted_files_grow_no_process_and_the_rest_is_verified(
    capsys: pytest.CaptureFixture[str],
) -> None:
    seed = random.randrange(2**32)
    folder = REPOSITORY / "build" / f"days-{seed}"  # It stays if the test fails.
    folder.mkdir(parents=True)
    split = "--split", f"{DAYS_CYCLES * 10 // FILES}s"
    restart = "--set", "restart.when=always", "--set", "restart.frozen_s=60"
    with commands_in(folder) as start:
        run = start("launch", "thousand", "--duration", f"c{DAYS_CYCLES}", *split, *restart)
        kills, lives = live_long(run, random.Random(seed), folder / "uses.csv")
        assert run.process.wait(timeout=900) == 1, "messages were lost"
    summary = msgspec.json.decode((run.folder / "summary.json").read_bytes())
    found = verify(run.folder)
    long_lives = {life: uses for life, uses in lives.items() if len(uses) >= max(SAMPLES // 10, 20)}
    memory = {life: early_and_late_mb(uses) for life, uses in long_lives.items()}
    with capsys.disabled():
        print(f"\n{folder}: {kills.total()} kills, {found.total('compared'):,} of {found.asked:,}")
        for life, (early_mb, late_mb) in memory.items():
            print(*life, f"{early_mb:.2f} MB, then {late_mb:.2f} MB")
    members = load_plan(run.folder / "plan.json").wiring.members
    restarts = Counter[str]()
    for name, count in kills.items():
        restarts.update(dict.fromkeys(members.get(name, (name,)), count))
    assert summary["restarts"] == restarts
    assert (summary["given_up"], summary["cycles"]) == ({}, DAYS_CYCLES)
    assert {"launcher", "fork server", PLANT, RECORDER} <= {name for name, _ in memory}
    for life, uses in long_lives.items():
        tenth = len(uses) // 10
        early, late = uses[tenth : 2 * tenth], uses[-tenth:]
        assert min(use.files for use in late) <= max(use.files for use in early), life
    assert {life: mb for life, mb in memory.items() if has_grown(life[0], *mb)} == {}
    assert_equal_as_far_as_recorded(run, found)
    assert found.total("compared") > 0
    shutil.rmtree(folder)


def live_long(
    run: Heliarch, drawn: random.Random, series: Path
) -> tuple[Counter[str], dict[tuple[str, int], list[Use]]]:
    """Kill a process of the run at each fourth sample, and delete all but its newest files.

    Returns how often each was killed, and what each process, by name and number, took.
    """
    run.until_running()
    names = load_plan(run.folder / "plan.json").processes
    victims = [name for name in names if name not in {PLANT, RECORDER}]
    kills = Counter[str]()
    lives: dict[tuple[str, int], list[Use]] = {}
    running = {"launcher": psutil.Process(run.process.pid), "fork server": run.fork_server()}
    running |= {name: run.process_of(name) for name in names}
    with series.open("w", buffering=1) as file:
        for sample in range(SAMPLES * 15 // 16):  # Its output is 2 s behind.
            cycle = DAYS_CYCLES * sample // SAMPLES
            until_cycle(run, cycle)
            for name, process in running.items():
                with suppress(psutil.Error):  # It was killed, and may not have begun again.
                    use = use_of(process)
                    lives.setdefault((name, process.pid), []).append(use)
                    said = f"{use.files},{use.threads},{use.own_mb}"
                    file.write(f"{cycle},{name},{process.pid},{said}\n")
            if sample % 4 == 0 < sample:
                # Three recorders, so that some of them live long.
                victim = drawn.choice(victims) if sample * 4 % SAMPLES else RECORDER
                killed = running[victim]
                killed.send_signal(signal.SIGKILL)
                kills[victim] += 1
                file.write(f"{cycle},{victim},{killed.pid},killed\n")
                run.until(partial(find_new, run, victim, running), f"a new {victim}")
            for _, path in further_files(run.folder / RECORDING_NAME)[:-KEPT_FILES]:
                path.unlink()
    return kills, lives


def find_new(run: Heliarch, name: str, running: dict[str, psutil.Process]) -> bool:
    """Note the new process of a name, once it is there and alone in writing its log."""
    killed = running[name]
    with suppress(ValueError):
        running[name] = run.process_of(name)
    return bool(running[name] != killed)


def early_and_late_mb(uses: list[Use]) -> tuple[float, float]:
    """The memory of a process in the second tenth of its life, and in the last one."""
    tenth = len(uses) // 10
    early, late = uses[tenth : 2 * tenth], uses[-tenth:]
    return median(use.own_mb for use in early), median(use.own_mb for use in late)


def has_grown(name: str, early_mb: float, late_mb: float) -> bool:
    if name == RECORDER:
        return late_mb > FILLED_MB
    return late_mb - early_mb > max(MOST_GROWTH * early_mb, MOST_GROWTH_MB)


@pytest.mark.timeout(1800)
def test_a_thousand_inverters_start_again_and_again(heliarch: Start) -> None:
    for _ in range(3):
        run = heliarch("launch", "thousand", "--duration", "1m", "--set", "processes=agent")
        assert run.process.wait(timeout=600) == 0
        summary = msgspec.json.decode((run.folder / "summary.json").read_bytes())
        assert (summary["cycles"], summary["messages_lost"]) == (6, 0)


@pytest.mark.timeout(600)
def test_kills_amid_large_bundles_are_counted_and_the_rest_is_verified(heliarch: Start) -> None:
    words = "--duration", "c40", "--set", "restart.when=on-failure"
    run = heliarch("launch", "thousand", *words)
    for cycle, victim in ((5, "z3"), (15, RECORDER)):
        run.until_recorded(cycle)
        run.process_of(victim).send_signal(signal.SIGKILL)
    assert run.process.wait(timeout=400) == 1
    summary = msgspec.json.decode((run.folder / "summary.json").read_bytes())
    group = load_plan(run.folder / "plan.json").wiring.members["z3"]
    assert summary["restarts"] == dict.fromkeys([*group, RECORDER], 1)
    assert summary["cycles"] == 40
    with RunReader(run.folder) as recording:
        overview, _ = read_through(recording)
    assert summary["messages_lost"] == sum(overview.lost.values()) > 0
    found = verify(run.folder)
    assert found.total("compared") > 0
    assert_equal_as_far_as_recorded(run, found)
