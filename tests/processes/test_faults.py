"""What happens when a part of the team dies, freezes or is told to stop."""

from __future__ import annotations

import gc
import io
import re
import shutil
import signal
from pathlib import Path

import psutil
import pytest
from command_line import python
from rich.console import Console
from running import Heliarch, Start, assert_none_left
from test_launch import summary_of
from test_restarts import GROUPED
from verifying import assert_equal_as_far_as_recorded

from agents.plan_file import load_plan
from agents.process import events
from bus_schemas.errors import InputError
from bus_schemas.messages import GivenUp, parse_missing
from bus_schemas.signals import COMMAND, GIVEN_UP, IMPP
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import RECORDER
from heliarch.cli.live_view import PlainView
from launch_scripts.fork_server_process import fork_server
from launch_scripts.launch import run_as_processes
from launch_scripts.processes import Processes
from launch_scripts.run_folder import RunFolder
from recordings.read.reader import RunReader
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


# The plant alone ends a run. Whoever else dies is named, and no process is left -------------------


def test_a_killed_plant_ends_the_run_and_is_named(run: Heliarch) -> None:
    process = run.process_of("plant")
    process.send_signal(signal.SIGKILL)
    assert run.wait() == 1
    assert f"plant (process {process.pid})" in run.error_text()
    assert "in the middle of the run" in run.error_text()
    assert not (run.folder / "orders.sock").exists()
    assert run.recorded_cycles() > 0


@pytest.mark.parametrize(
    ("words", "victims", "harm"),
    [
        (
            ("--pace", "20", "--set", "restart.when=never"),
            (INVERTER, "c1", "central", RECORDER),
            signal.SIGTERM,
        ),
        (("--set", "restart.frozen_s=1"), (INVERTER, "c1", "central"), signal.SIGSTOP),
        (GROUPED, ("c2",), signal.SIGTERM),
    ],
)
def test_a_process_that_is_not_started_again_is_given_up_and_the_run_goes_on(
    heliarch: Start,
    plant: str,
    words: tuple[str, ...],
    victims: tuple[str, ...],
    harm: signal.Signals,
) -> None:
    run = heliarch("launch", plant, "--duration", "10h", *words)
    run.until_recorded()
    for victim in victims:
        run.until_recorded(run.recorded_cycles() + 3)
        run.process_of(victim).send_signal(harm)
        run.until_shown(f"without {victim}")
    if RECORDER not in victims:
        run.until_recorded(run.recorded_cycles() + 3)
    assert run.interrupt() == 1
    assert victims[0] in run.error_text()
    assert run.output.read_text().count("has not beaten") == (harm == signal.SIGSTOP) * len(victims)
    wiring = load_plan(run.folder / "plan.json").wiring
    agents = [agent for victim in victims for agent in wiring.members[victim]]
    assert list(summary_of(run.folder).given_up) == agents
    with RunReader(run.folder) as reader:
        (*_, (_, told)) = reader.messages(GIVEN_UP)
        assert isinstance(told, GivenUp)
        assert set(told.agents) == {*agents} - {RECORDER}
    assert_equal_as_far_as_recorded(run, verify(run.folder))


@pytest.mark.parametrize(
    ("harm", "said"),
    [("SIGKILL", "killed by signal 9 before cycle 0"), ("SIGSTOP", "not come onto the bus")],
)
def test_a_process_that_dies_or_freezes_before_cycle_0_is_named_and_started_again(
    heliarch: Start,
    plant: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    harm: str,
    said: str,
) -> None:
    code = HARMED_ONCE.replace("FOLDER", repr(str(tmp_path))).replace("HARM", harm)
    (tmp_path / "sitecustomize.py").write_text(code, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    run = heliarch("launch", plant, "--duration", "5")
    assert run.wait() == 0, run.error_text()
    restarts = summary_of(run.folder).restarts
    for victim in (RECORDER, INVERTER):
        pid = (tmp_path / f"harmed {victim.replace('/', '.')}").read_text()
        (line,) = (one for one in run.output.read_text().splitlines() if f"process {pid})" in one)
        assert victim in line
        assert said in line
        assert restarts[victim] >= 1, "more if a new one was slow to start as well"


HARMED_ONCE = f"""
import os, signal
from pathlib import Path
import launch_scripts.process as process

run_process = process.run_process

def harmed_once(agent, *arguments, **options):
    flag = Path(FOLDER) / f"harmed {{agent.replace('/', '.')}}"
    if agent in ({INVERTER!r}, "recorder") and not flag.exists():
        flag.write_text(str(os.getpid()))
        os.kill(os.getpid(), signal.HARM)
    return run_process(agent, *arguments, **options)

process.run_process = harmed_once
"""


@pytest.mark.parametrize("name", [INVERTER, "c1", "central"])
def test_a_run_whose_folder_and_plan_are_gone_starts_controllers_again_and_fails_at_its_end(
    heliarch: Start, plant: str, name: str
) -> None:
    run = heliarch("launch", plant, "--duration", "1h", "--pace", "20")
    run.until_recorded()
    process = run.process_of(name)
    (run.folder / "plan.json").write_text("{", encoding="utf-8")
    shutil.rmtree(run.folder)
    process.send_signal(signal.SIGKILL)
    run.until_shown("it is started again")
    cycle = re.compile(r"(\d+) of [\d,]+ cycles")
    last = int(cycle.findall(run.output.read_text())[-1])
    run.until(lambda: int(cycle.findall(run.output.read_text())[-1]) > last, "a later cycle")
    assert run.interrupt() == 1
    assert "Traceback" not in run.error_text() + run.output.read_text()
    assert "gave up" not in run.output.read_text(), "it needs nothing of the folder"


def test_a_recorder_that_dies_after_the_folder_is_gone_is_given_up_in_one_line(
    heliarch: Start, plant: str
) -> None:
    run = heliarch("launch", plant, "--duration", "1h", "--pace", "20")
    run.until_recorded()
    recorder = run.process_of(RECORDER)
    shutil.rmtree(run.folder)
    recorder.send_signal(signal.SIGKILL)
    run.until_shown("the run goes on without recorder")
    assert run.interrupt() == 1
    said = run.output.read_text() + run.error_text()
    assert "Traceback" not in said
    assert [line for line in said.splitlines() if "recorder (process" in line] == [
        f"recorder (process {recorder.pid}) was killed by signal 9 in the middle of the run, and "
        "the run's folder has been removed; it is given up: the run goes on without recorder"
    ]


@pytest.mark.parametrize("killed", ["launcher", "fork server"])
def test_a_killed_launcher_or_fork_server_leaves_no_process_and_a_whole_recording(
    run: Heliarch, killed: str
) -> None:
    server = run.fork_server()
    assert server.ppid() == run.process.pid
    agents = [found for found in run.processes() if found != server]
    assert len(agents) == len(list((run.folder / "logs").glob("*.log"))) == 9
    assert {agent.ppid() for agent in agents} == {server.pid}
    if killed == "launcher":
        run.process.send_signal(signal.SIGKILL)
        run.wait()
    else:
        server.send_signal(signal.SIGKILL)
        assert run.wait() == 1
        assert f"fork server (process {server.pid})" in run.error_text()
    assert_none_left(run.folder)
    with RunReader(run.folder) as reader:
        assert reader.whole, "its recorder has closed its file"


# Frozen -------------------------------------------------------------------------------------------


def test_a_fork_server_that_stands_still_at_the_end_is_named_and_the_run_has_its_summary(
    heliarch: Start, plant: str
) -> None:
    run = heliarch("launch", plant, "--duration", "100")
    run.until_shown("armed")
    server = run.fork_server()
    server.send_signal(signal.SIGSTOP)
    assert run.wait() == 1
    assert "fork server" in run.error_text()
    assert f"fork server (process {server.pid}) stands still" in run.output.read_text()
    summary = summary_of(run.folder)
    assert (summary.cycles, summary.lost, [*summary.given_up]) == (100, 0, ["fork server"])
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
    assert summary.missing_inputs > 0
    with RunReader(run.folder) as reader:
        reports = [message.cycle for _, message in reader.messages(IMPP, nodes="c1")]
    assert reports == sorted(set(reports)), "no cycle twice"
    assert reports[-1] > 14, "it goes on in the cycle under way"
    assert len(reports) < 18
    assert_equal_as_far_as_recorded(run, verify(run.folder))


def test_faults_act_on_the_links_inside_a_group(heliarch: Start, plant: str) -> None:
    rule = "signal=setpoint,listener=c1/inv02,loss=100%,at=5s..15s"  # Not the group's first agent.
    run = heliarch("launch", plant, "--duration", "1h", "--pace", "10", *GROUPED, "--fault", rule)
    run.until_recorded(25)
    assert run.interrupt() == 130, run.error_text()
    with RunReader(run.folder) as reader:
        lacks = {
            message.cycle: any(
                key == "c1/inv02/setpoint" for key, _ in map(parse_missing, message.missing)
            )
            for _, message in reader.messages(COMMAND, nodes="c1/inv02")
        }
    during = [lacks[cycle] for cycle in lacks if 5 <= cycle < 15]
    assert during
    assert all(during)
    assert not all(lacks.values())


# What a run takes of the machine ------------------------------------------------------------------


def test_imports_of_the_fork_server_start_no_thread() -> None:
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
        with fork_server() as server:
            view = PlainView(Console(file=io.StringIO()), preparation.plan)
            run_as_processes(preparation, RunFolder(tmp_path / f"run{number}"), view, 0.0, server)
        gc.collect()  # what earlier tests left behind would be counted in the first run alone
        own = psutil.Process()
        return own.num_fds(), len(own.children(recursive=True)), own.num_threads()

    first, second = run(1), run(2)
    assert all(after <= before for before, after in zip(first, second, strict=True))


def test_requests_wait_for_a_fork_server_that_does_not_read(plant: str, tmp_path: Path) -> None:
    preparation = prepare(load_scenario(plant), RunOptions(duration="5"), "asked")
    folder = RunFolder(tmp_path / "run")
    with reserved_ports(preparation.plan.links.listening) as tcp_ports:
        plan = folder.fill(preparation, tcp_ports)
        with (
            fork_server() as server,
            Processes(server, plan, (RECORDER,), folder, print) as processes,
        ):
            server.side.process.send_signal(signal.SIGSTOP)
            for _ in range(2000):  # More than the socket between them takes.
                processes.ask(events.SendSignal(RECORDER, signal.SIGCONT))
            processes.start()
            server.side.process.send_signal(signal.SIGCONT)
            while not processes[RECORDER].is_there:
                processes.look()
    assert_none_left(folder.path)


def test_a_folder_in_which_another_run_has_begun_meanwhile_is_refused(tmp_path: Path) -> None:
    RunFolder(tmp_path / "run").make()
    with pytest.raises(InputError, match="another run"):
        RunFolder(tmp_path / "run").make()
