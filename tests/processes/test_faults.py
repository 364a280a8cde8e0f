"""What happens when a part of the team dies, freezes or is told to stop."""

from __future__ import annotations

import gc
import io
import re
import signal
from pathlib import Path

import psutil
import pytest
from command_line import python
from rich.console import Console
from running import Heliarch, Start, assert_none_left, small_plant
from test_launch import summary_of
from verifying import assert_equal_as_far_as_recorded

from bus_schemas.signals import IMPP
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import RECORDER
from heliarch.cli.live_view import PlainView
from launch_scripts import fork_requests
from launch_scripts.launch import launch
from launch_scripts.run_folder import RunFolder
from launch_scripts.supervision import Children, ForkServerProcess
from recordings.read.reader import RunReader
from recordings.read.run_file import log_name
from recordings.verify.verification import verify
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import load_scenario

pytestmark = pytest.mark.processes


INVERTER = "c2/inv03"


@pytest.fixture
def run(heliarch: Start, plant: str) -> Heliarch:
    """A run that would go on for long, in its first cycles, of which some are on disk."""
    words = ("--duration", "1h", "--pace", "20", "--set", "restart.when=never")
    command = heliarch("launch", plant, *words)
    command.until_recorded()
    return command


# Whoever is killed, the run ends, says who it was, and leaves no process -------------------------


@pytest.mark.parametrize(
    ("victim", "number"),
    [
        (INVERTER, signal.SIGTERM),
        ("plant", signal.SIGKILL),
        ("recorder", signal.SIGTERM),
    ],
)
def test_a_process_that_a_signal_ends_ends_the_run_and_is_named(
    run: Heliarch, victim: str, number: signal.Signals
) -> None:
    process = run.process_of(victim)
    process.send_signal(number)
    assert run.wait() == 1
    assert f"{victim} (process {process.pid})" in run.error_text()
    assert run.recorded_cycles() > 0


def test_the_fork_server_is_the_parent_of_all_agents_and_killed_it_is_named(run: Heliarch) -> None:
    server = run.fork_server()
    assert server.ppid() == run.process.pid
    agents = [found for found in run.processes() if found != server]
    assert len(agents) == 9
    assert {agent.ppid() for agent in agents} == {server.pid}
    assert len(list((run.folder / "logs").glob("*.log"))) == 9
    server.send_signal(signal.SIGKILL)
    assert run.wait() == 1
    assert f"fork server (process {server.pid})" in run.error_text()
    assert_none_left(run.folder)
    assert is_whole(run), "its recorder has closed its file"


def is_whole(run: Heliarch) -> bool:
    with RunReader(run.folder) as reader:
        return reader.whole


def test_a_killed_launcher_leaves_no_process_and_a_whole_recording(run: Heliarch) -> None:
    run.process.send_signal(signal.SIGKILL)
    run.wait()
    assert_none_left(run.folder)
    assert is_whole(run)


BEGINS_LATE = """
import os, time
from recordings.record import recorder

run_recorder = recorder.run_recorder

def begin_late(*arguments):
    server = os.getppid()
    print("begun", flush=True)
    while os.getppid() == server:
        time.sleep(0.01)
    return run_recorder(*arguments)

recorder.run_recorder = begin_late
"""


def test_a_recorder_that_has_hardly_begun_when_its_launcher_is_killed_ends_too(
    heliarch: Start, plant: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sitecustomize.py").write_text(BEGINS_LATE, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    run = heliarch("launch", plant)
    log = run.folder / "logs" / log_name(RECORDER)
    run.until(lambda: log.exists() and "begun" in log.read_text(), "the recorder's beginning")
    run.process.send_signal(signal.SIGKILL)
    run.wait()
    assert_none_left(run.folder)


# Frozen -------------------------------------------------------------------------------------------


def test_in_lockstep_a_frozen_process_ends_the_run_and_is_named_with_those_who_wait_for_it(
    heliarch: Start, tmp_path: Path
) -> None:
    impatient = ("stall_timeout_s = 60", "stall_timeout_s = 3")
    run = heliarch("launch", small_plant(tmp_path / "plant", impatient))
    run.until_recorded()
    run.process_of(INVERTER).send_signal(signal.SIGSTOP)
    assert run.wait() == 1
    # Where in its cycle it froze decides whether its parent or the plant misses it first.
    named = rf"stopped by a signal: {INVERTER}(.|\n)*(c2|plant) waits for {INVERTER}/"
    assert re.search(named, run.error_text()), run.error_text()


def test_a_recorder_that_stands_still_as_a_short_run_ends_is_named_and_not_who_waits_for_it(
    heliarch: Start, plant: str
) -> None:
    run = heliarch("launch", plant, "--duration", "100")
    run.until_shown("armed")
    run.process_of("recorder").send_signal(signal.SIGSTOP)
    assert run.wait() == 1
    assert "recorder" in run.error_text().splitlines()[0]
    assert_none_left(run.folder)


def test_a_run_over_a_bad_network_with_a_supervisor_that_stood_still_verifies_equal(
    heliarch: Start, plant: str
) -> None:
    rules = "delay=5ms,jitter=4ms,loss=8%", "signal=command,duplicate=10%", "freeze=c1,at=8s..14s"
    faults = [word for rule in rules for word in ("--fault", rule)]
    run = heliarch("launch", plant, "--pace", "5", "--duration", "20", *faults)
    run.wait()
    summary = summary_of(run.folder)
    # The plant ticks through all cycles, and says of each what it delivered.
    production = next(count for count in summary.messages if count.signal == "production")
    assert (production.published, summary.cycles) == (20, production.recorded)
    assert summary.health is not None
    assert set(summary.health.faults) == {"lost", "duplicated", "delayed"}
    assert summary.missing_inputs > 0
    with RunReader(run.folder) as reader:
        reports = [message.cycle for _, message in reader.messages(IMPP, nodes="c1")]
    assert reports == sorted(set(reports)), "no cycle twice"
    assert reports[-1] == 19, "it goes on in the cycle under way"
    assert len(reports) < 18
    assert_equal_as_far_as_recorded(run, verify(run.folder))


# What a run takes of the machine ------------------------------------------------------------------


def test_what_the_fork_server_imports_starts_no_thread() -> None:
    code = (
        "import launch_scripts.fork_server, psutil; own = psutil.Process(); "
        "print(own.num_threads(), len(own.net_connections()))"
    )
    done = python(code, variables={"OPENBLAS_NUM_THREADS": "1"})
    assert done.stdout.split() == ["1", "0"]


def test_after_a_run_the_launcher_has_no_more_files_and_processes_than_before(
    plant: str,
    tmp_path: Path,
) -> None:
    scenario = load_scenario(plant)

    def run(number: int) -> tuple[int, int, int]:
        preparation = prepare(scenario, RunOptions(duration="5"), f"run{number}")
        with ForkServerProcess() as server:
            view = PlainView(Console(file=io.StringIO()), preparation.plan)
            launch(preparation, RunFolder(tmp_path / f"run{number}"), view, 0.0, server)
        gc.collect()  # what earlier tests left behind would be counted in the first run alone
        own = psutil.Process()
        return own.num_fds(), len(own.children(recursive=True)), own.num_threads()

    first, second = run(1), run(2)
    assert all(after <= before for before, after in zip(first, second, strict=True))


def test_requests_wait_for_a_fork_server_that_does_not_read(plant: str, tmp_path: Path) -> None:
    preparation = prepare(load_scenario(plant), RunOptions(duration="5"), "asked")
    folder, agents = RunFolder(tmp_path / "run"), (RECORDER,)
    with reserved_ports(preparation.plan.links.listening) as tcp_ports:
        plan, server = folder.fill(preparation, tcp_ports), ForkServerProcess()
        with Children(server, plan, agents, folder.logs) as children:
            children.events(0.0)
            server.process.send_signal(signal.SIGSTOP)
            for _ in range(2000):  # More than the socket between them takes.
                server.ask(fork_requests.Signal(agents, signal.SIGCONT))
            server.ask(fork_requests.Start(str(folder.plan), agents, str(folder.logs), 0.0))
            server.process.send_signal(signal.SIGCONT)
            while not children[RECORDER].ready:
                children.events(0.1)
    assert_none_left(folder.path)
