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
from recordings.verify.verification import verify

pytestmark = [pytest.mark.processes, pytest.mark.soak]

SOAK_S = int(os.environ.get("SOAK_S", "1800"))
RATE = 5
BETWEEN_FAULTS = 5 * RATE
LONGEST_CUT_S = 4.0
SETTLED_MB = 15.0
"""What plant and recorder come to once each of their buffers has been in use: in the first minutes
a recorder grows from 10 to 14.5 MB, and then no more."""


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
