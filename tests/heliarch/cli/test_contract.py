"""What holds for every command: bad input, a full disk, `| head`, Ctrl-C and SIGTERM."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout, suppress
from pathlib import Path
from signal import SIGHUP, SIGINT, SIGTERM
from typing import Final, TextIO

import psutil
import pytest
from command_line import heliarch, process, refusal
from order_desks import obeying_plant
from plans_by_hand import with_changes
from recordings_by_hand import cut, whole_run, write_run, zero_chunk
from replayed_runs import PLAN, run_in_memory, write
from running import REPOSITORY, small_plant
from timed_recordings import cycle, recorded

from heliarch.cli.app import COMMANDS, run_command

NAMES: Final = [name for names in COMMANDS.values() for name in names]
FULL: Final = Path("/dev/full")

QUICK: Final = {
    "launch": "small.toml --duration 5",
    "node": "--plan there.json --host 127.0.0.2",
    "simulate": "small.toml --duration 5",
    "timing": "timed",
    "inverters": "small.toml --duration 1 --port 0",
    "conform": "c1/inv01 --scenario small.toml --pace max --external-timeout 0.1 --command true",
    "scenarios": "",
    "init": "positions.csv ghi.csv --out new.toml",
    "order": "RUN 100kW",
    "view": "RUN",
    "report": "RUN",
    "inspect": "RUN --nodes c1",
    "verify": "RUN",
    "replay": "RUN --pace max",
    "compare": "small.toml --duration 5 --schemes paper",
    "diff": "RUN run",
    "export": "RUN --format csv",
    "doctor": "",
    "keys": "small.toml",
}
"""For each command words with which it has done its work in seconds; `view` serves until Ctrl-C."""

LONG: Final = {
    "launch": (SIGHUP, "small.toml --pace 1"),
    "conform": (SIGINT, "c1/inv01 --scenario small.toml --command 'sleep 100'"),
    "inspect": (SIGTERM, "long.mcap --nodes '*'"),  # Nobody reads it: it waits in its output.
    "replay": (SIGHUP, "long.mcap --pace 1"),
    "compare": (SIGINT, "small.toml --seeds 1..1000 --workers 2"),
}
"""Words with which it takes long enough to be ended, and the signal that ends it: one command for
each way to work."""


@pytest.fixture(scope="module")
def master(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scenario, its own data, a plan for another host, and two recorded runs."""
    path = tmp_path_factory.mktemp("master")
    small_plant(path)
    ports = dict.fromkeys(PLAN.links.listening, 7_999)
    there = with_changes(PLAN, addresses={"c1": "127.0.0.2"}, tcp_ports=ports)
    (path / "there.json").write_bytes(there.as_json())
    (path / "here.json").write_bytes(PLAN.as_json())
    write(path / "run", run_in_memory())
    for name in ("positions.csv", "ghi.csv"):
        shutil.copy(REPOSITORY / "examples" / "own_plant" / name, path)
    (path / "timed").mkdir()
    recorded(path / "timed", cycle(0), cycle(1))
    return path


@pytest.fixture
def folder(master: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A working folder of its own for a test."""
    shutil.copytree(master, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    with obeying_plant(tmp_path / "run", PLAN):
        yield tmp_path


def words_of(name: str, folder: Path) -> list[str]:
    return [name, *QUICK[name].replace("RUN", str(folder / "run")).split()]


def test_every_command_is_held_to_the_contract() -> None:
    assert sorted(QUICK) == sorted(NAMES)


# Bad input ----------------------------------------------------------------------------------------

REFUSED: Final = """
simulate small.toml --to 13:00 --duration 1h                            --duration
launch small.toml --duration -5s                                        --duration=-1
simulate small.toml --pace fast                                         --pace
simulate small.toml --seed 1 --seed 2                                   --seed
simulate small.toml --sceme paper                                       --scheme
simulate small.toml --set commitment.share                              --set
simulate small.toml --set commitment.share=0.1,0.2                      commitment.share
simulate small.toml --set title=caf\udce9                               UTF-8
simulate small.toml --out run                                           --out
simulate small.toml --data nowhere                                      --data
simulate small.toml --page-port 8000                                    --page-port
simulate small.toml --page --orders                                     --orders
simulate small.toml --json run/run.mcap                                 --json
simulate small.toml small.toml                                          got small.toml
simulate oahuu                                                          oahu
simulate oahu --set time.duration_s=2590000 --set time.cycle_s=0.4      time.duration_s
launch small.toml --external c9                                         --external
launch small.toml --cpus x                                              --cpus
launch small.toml --set processes=cluster --cpus direct=0               --cpus
launch small.toml --fault loss=1%                                       --pace
launch small.toml --device c9=modbus://10.0.0.7/1                       --device
launch small.toml --device c1/inv01=modbus://127.0.0.1/1                --pace
launch small.toml --pace 1 --actuator fraction --device c1/inv01=modbus://h/1  actuator
launch small.toml --pace 1 --device meter=modbus://127.0.0.1:1/1        meter
launch small.toml --address 10.1.2.3                                    --address
launch small.toml --keys keys/small                                     --secure
launch small.toml --on 127.0.0.2=plant                                  --on
launch small.toml --on 127.0.0.2=c2                                     --secure
lanch small.toml                                                        launch
nonsense                                                                nonsense
node --plan nowhere.json --host 127.0.0.2                               nowhere.json
node --plan here.json --host 127.0.0.2                                  --host
node --plan there.json --host 127.0.0.2 --keys run                      --keys
inverters small.toml --port -1                                          --port
order run 100kW --ramp 0kW/min                                          --ramp
timing timed --rate 20                                                  --rate
timing small.toml --rate 0.1..5 --duration 5s                           --duration
timing small.toml --rate 5..10 --out run                                --out
conform c9 --scenario small.toml --command true                         AGENT
conform c1/inv01 --scenario small.toml --pace 0 --command true          --pace
conform c1/inv01 --scenario small.toml --command {plan                  --command
view run --page-port -1                                                 --page-port
report run --report nowhere/report.html                                 --report
inspect run --nodes c1/aa                                               c1/a
inspect run --cycle 3 --nodes c1                                        --nodes
inspect run --from 3                                                    --nodes
verify run --nodes c1/aa                                                --nodes
replay run --pace nan                                                   --pace
replay run --listen 7447                                                --listen
replay run --without c1 --loop                                          --loop
compare small.toml --schemes magic                                      --schemes
compare small.toml --show beauty                                        --show
compare small.toml --seeds x                                            --seeds
compare small.toml --csv -                                              --csv
compare small.toml --seeds 1,2 --report                                 --report
compare small.toml --days 2010-04-01 --from 2010-04-01T12:00            --from
compare run                                                             diff
diff run                                                                SECOND
export run                                                              --format
export run --format xlsx                                                --format
export run --format csv --clock sim                                     --clock
export run --format mcap --nodes c1                                     --nodes
keys small.toml --days nan                                              --days
doctor --out nowhere                                                    --out
"""
"""What each command refuses, and what its one line names."""


def refused(command: str) -> list[tuple[list[str], str]]:
    """Words that a command refuses, each with what is named; any file that cannot be is one."""
    rows = [re.split(r" {2,}", line) for line in REFUSED.strip().splitlines()]
    found = [(words.split(), named) for words, named in rows if words.split()[0] == command]
    if command in QUICK and command not in {"view", "report", "inverters", "node", "init"}:
        found.append(([*words_of(command, Path()), "--json=nowhere/x"], "--json"))
    if "RUN" in QUICK.get(command, ""):
        for bad in ("nowhere", "text.mcap", "pipe.mcap", "empty"):
            found.append(([command, *QUICK[command].replace("RUN", bad).split()], ""))
    return found


@pytest.mark.parametrize("command", [*NAMES, "lanch", "nonsense"])
def test_bad_input_is_one_line_that_names_it_and_leaves_nothing(command: str, folder: Path) -> None:
    (folder / "text.mcap").write_text("cycle,power_kw\n")
    (folder / "empty").mkdir()
    os.mkfifo(folder / "pipe.mcap")
    before = sorted(folder.rglob("*"))
    wrong = [
        (words, line) for words, named in refused(command) if named not in (line := refusal(*words))
    ]
    assert wrong == []
    assert sorted(folder.rglob("*")) == before


def test_without_a_command_the_help_is_shown() -> None:
    result = heliarch()
    assert result.exit_code == 2
    assert all(word in result.stdout for word in (*COMMANDS, *NAMES))


# A recording that is not whole --------------------------------------------------------------------

CUT: Final = {
    "inspect": "heliarch export --format mcap",
    "replay": "cut short",
    "export": "cut short",
    "report": "recording is incomplete",
}
"""How each command says that the recording was cut."""


@pytest.mark.parametrize("name", CUT)
def test_a_cut_recording_is_used_up_to_the_cut_which_is_named(name: str, folder: Path) -> None:
    cut(folder / "run" / "run.mcap")
    result = heliarch(*words_of(name, folder))
    pages = [page.read_text(encoding="utf-8") for page in folder.rglob("report.html")]
    assert result.exit_code == 0, result.output
    assert CUT[name] in " ".join([*result.stdout.split(), *pages])


@pytest.mark.parametrize("name", ["inspect", "export", "report", "verify", "replay"])
def test_a_damaged_part_is_left_out_and_named_in_one_line(name: str, folder: Path) -> None:
    place = zero_chunk(folder / "run" / "run.mcap", 2)
    result = heliarch(*words_of(name, folder))
    assert result.exit_code == (1 if name == "verify" else 0), result.output
    (line,) = result.stderr.splitlines()
    assert f"damaged and left out (chunk at byte {place.offset:,})" in line


# A full disk --------------------------------------------------------------------------------------

full_disk = pytest.mark.skipif(not FULL.exists(), reason="this system has no device that is full")


@full_disk
@pytest.mark.parametrize(
    ("name", "option"),
    [
        *(("simulate", "--json"), ("timing", "--json"), ("simulate", "--report")),
        ("compare", "--csv"),
    ],
)
def test_a_file_on_a_full_disk_is_a_failure_in_one_line_and_the_rest_is_written(
    name: str, option: str, folder: Path
) -> None:
    (folder / "full.html").symlink_to(FULL)
    words = [*words_of(name, folder), option, "full.html"]
    if name in {"simulate", "timing", "compare"} and option != "--report":
        words += ["--report", "page.html"]
    result = heliarch(*words)
    assert result.exit_code == 1, result.output
    (line,) = result.stderr.splitlines()
    assert "full.html" in line
    assert FULL.is_char_device()
    assert (folder / "page.html").exists() == ("page.html" in words)
    assert result.stdout, "what took long to find is not lost"


def output_to(
    output: TextIO, words: list[str], capsys: pytest.CaptureFixture[str]
) -> tuple[int, str]:
    """Run a command in this process with its own standard output, which is a file.

    Return its exit status and standard error. What it leaves in the buffer is flushed as at the
    end of a process: that must not fail.
    """
    with redirect_stdout(output):
        with pytest.raises(SystemExit) as caught:
            run_command(words)
        sys.stdout.flush()
    with suppress(OSError):
        output.close()
    status = caught.value.code
    assert isinstance(status, int)
    return status, capsys.readouterr().err


@full_disk
@pytest.mark.parametrize("name", ["simulate", "timing", "inspect"])
def test_standard_output_on_a_full_disk_is_a_failure_in_one_line(
    name: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, errors = output_to(FULL.open("w"), words_of(name, folder), capsys)
    assert (status, len(errors.splitlines())) == (1, 1), errors


# The reader leaves --------------------------------------------------------------------------------


def pipe_without_reader() -> TextIO:
    """Standard output as `head -0` leaves it."""
    reading, writing = os.pipe()
    os.close(reading)
    return os.fdopen(writing, "w")


@pytest.mark.parametrize("name", ["timing", "inspect"])
def test_a_reader_who_leaves_is_no_error_message(
    name: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = words_of(name, folder)
    is_measured = name == "timing"
    if is_measured:
        words += ["--json", "figures.json"]
    assert output_to(pipe_without_reader(), words, capsys) == (1, "")
    if is_measured:
        assert json.loads((folder / "figures.json").read_text()), "it is written before that"


# Ctrl-C and SIGTERM -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def long_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that takes seconds to read."""
    path = tmp_path_factory.mktemp("long") / "long.mcap"
    write_run(path, whole_run(8_000), close=False)
    return path


@pytest.fixture
def started() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start commands; nothing of them outlives the test."""
    running: list[subprocess.Popen[str]] = []

    def start(*words: str, cwd: Path, program: str = "") -> subprocess.Popen[str]:
        running.append(process(*words, cwd=cwd, program=program))
        return running[-1]

    yield start
    for one in running:
        with suppress(ProcessLookupError):
            os.killpg(one.pid, signal.SIGKILL)
        one.communicate()


def is_at_work(found: subprocess.Popen[str]) -> bool:
    """Whether a command has come to what it must clean up: workers, processes, or an open file."""
    assert found.poll() is None, found.communicate()
    with suppress(psutil.Error):
        one = psutil.Process(found.pid)
        return (
            bool(one.children())
            or any(
                "long.mcap" in entry.path or entry.path.endswith(("run.mcap", ".mcap"))
                for entry in one.open_files()
            )
            or any("numba" in entry.path for entry in one.memory_maps())
        )
    return False


@pytest.mark.processes
@pytest.mark.parametrize("name", LONG)
def test_a_signal_ends_a_command_with_its_status_and_leaves_nothing_behind(
    name: str,
    folder: Path,
    long_recording: Path,
    started: Callable[..., subprocess.Popen[str]],
) -> None:
    number, words = LONG[name]
    (folder / "long.mcap").symlink_to(long_recording)
    before = set(folder.iterdir())
    found = started(name, *shlex.split(words), cwd=folder)
    give_up_at = time.monotonic() + 100.0
    while not is_at_work(found):
        assert time.monotonic() < give_up_at
        time.sleep(0.1)
    children = psutil.Process(found.pid).children(recursive=True)
    os.kill(found.pid, number)
    _, errors = found.communicate(timeout=100)
    assert found.returncode == 128 + number, errors
    assert len(errors.splitlines()) <= 1, errors
    _, alive = psutil.wait_procs(children, timeout=30)
    assert not alive
    new = {path.name for path in folder.iterdir()} - {path.name for path in before}
    assert new <= {"runs"}


@pytest.mark.processes
def test_a_signal_that_is_ignored_stays_ignored(
    folder: Path, started: Callable[..., subprocess.Popen[str]]
) -> None:
    found = started("view", "run", cwd=folder, program="nohup")
    assert found.stdout is not None
    assert "http" in found.stdout.readline()
    for number in (SIGHUP, SIGTERM):
        time.sleep(0.5)
        assert found.poll() is None
        os.kill(found.pid, number)
    found.communicate(timeout=100)
    assert found.returncode == 128 + SIGTERM


@pytest.mark.parametrize("number", [SIGINT, SIGTERM])
def test_a_signal_counts_also_while_a_library_is_imported_that_catches_all(
    number: signal.Signals, tmp_path: Path
) -> None:
    library = f"""
import signal
try:
    signal.raise_signal({int(number)})
    sum(range(1_000))
except BaseException:
    pass
"""
    program = """
import signal, time
from heliarch.cli.boundary import boundary
signal.signal(signal.SIGINT, signal.default_int_handler)
with boundary():
    import library
    time.sleep(10.0)
"""
    (tmp_path / "library.py").write_text(library, encoding="utf-8")
    path = os.pathsep.join([str(tmp_path), str(REPOSITORY)])
    result = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert result.returncode == 128 + number, result.stderr


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("keys small.toml --out=", "--out"),
        ("keys small.toml --out ", "--out"),
        ("inspect ", "an argument"),
        ("simulate --out", "--out"),
    ],
)
def test_an_empty_word_is_named(words: str, named: str, folder: Path) -> None:
    assert named in refusal(*words.split(" "))


def test_a_word_too_many_is_named_as_it_was_typed() -> None:
    assert refusal("doctor", "my run").endswith("expected no more words, got my run")
