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
    "launch": (SIGTERM, "small.toml --pace 1"),
    "node": (SIGTERM, "--plan there.json --host 127.0.0.2"),
    "simulate": (SIGINT, "small.toml --pace 1"),
    "conform": (SIGINT, "c1/inv01 --scenario small.toml --command 'sleep 100'"),
    "inspect": (SIGTERM, "long.mcap --nodes '*'"),  # Nobody reads it: it waits in its output.
    "replay": (SIGHUP, "long.mcap --pace 1"),
    "compare": (SIGINT, "small.toml --seeds 1..1000 --workers 2"),
    "export": (SIGINT, "long.mcap --format csv"),
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


def with_json(names: list[str]) -> list[str]:
    return [name for name in names if name not in {"view", "report", "inverters", "node", "init"}]


def test_every_command_is_held_to_the_contract() -> None:
    assert sorted(QUICK) == sorted(NAMES)


# Bad input ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "option", "place"),
    [
        *((name, "--json", "nowhere/x") for name in with_json(NAMES)),
        *(("simulate", "--json", place) for place in ("run", "small.toml", "run/run.mcap")),
        ("launch", "--report", "nowhere/x.html"),
        ("simulate", "--report", "x.pdf"),
        ("compare", "--csv", "-"),
    ],
)
def test_a_file_that_cannot_be_is_refused_before_any_work(
    name: str, option: str, place: str, folder: Path
) -> None:
    before = sorted(folder.rglob("*"))
    assert option in refusal(*words_of(name, folder), f"{option}={place}")
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("name", [name for name in NAMES if "RUN" in QUICK[name]])
def test_what_is_no_recording_is_refused(name: str, folder: Path) -> None:
    (folder / "text.mcap").write_text("cycle,power_kw\n")
    (folder / "empty").mkdir()
    os.mkfifo(folder / "pipe.mcap")
    for bad in ("nowhere", "text.mcap", "pipe.mcap", "empty"):
        line = refusal(name, *QUICK[name].replace("RUN", bad).split())
        assert bad in line or "run.mcap" in line


BAD: Final = {
    "simulate": "--from noon, --to 11:00, --duration soon, --pace fast, --seed -1, --seed x, "
    "--seed 1.5, "
    "--scheme magic, --set commitment.share, --set no.such=1, --fault loss=2, --out run, "
    "--out /dev/null/run, --data nowhere, --page-port 8000, --page-address 0.0.0.0",
    "launch": "--external c9, --external recorder, --external-timeout 0, --external-timeout nan, "
    "--base-port 80, --base-port 65533, --cpus x, --device c9=modbus://10.0.0.7/1, "
    "--device c1/inv01=127.0.0.1:502, --on c2/*, "
    "--on 127.0.0.2=c9, --on 127.0.0.2=plant, --on lab=c2, --on 10.0.0.2=c2/*",
    "node": "--plan nowhere.json, --host 127.0.0.3, --keys run",
    "inverters": "--port -1, --address 203.0.113.1, --from noon",
    "order": "--ramp 5, --ramp -1kW/min, --ramp 0kW/min, --hold soon, --hold -1s",
    "timing": "--rate 20, --priority 20, --page-port 8000",
    "conform": "--pace 0, --tolerance -1, --external-timeout 0, --command {plan",
    "view": "--page-port -1, --page-address moon",
    "report": "--report nowhere/report.html",
    "inspect": "--nodes c9, --nodes ,, --from 18:00, --to noonish, --cycle 3",
    "verify": "--nodes c1/aa, --from 18:00, --tolerance -1",
    "replay": "--from 18:00, --from noon, --nodes c9, --pace -1, --pace nan, "
    "--signals imp, --signals ,, --listen 7447, --plan plan.json, --live c1/x, "
    "--live plant",
    "compare": "--schemes magic, --show beauty, --workers 0, --workers 1.5, --seeds x, --days x, "
    "--set x, --actuator magic, --fault magic",
    "export": "--format xlsx, --signals residuals, --nodes c1/inv99, --from 18:00, --clock sim, "
    "--out run",
    "keys": "--days -1, --days 0, --days nan, --days 4000, --address moon",
    "doctor": "--out nowhere",
}
"""Options of each command with a value that is refused."""


@pytest.mark.parametrize(
    ("name", "option", "value"),
    [(name, *one.split(" ")) for name, several in BAD.items() for one in several.split(", ")],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    name: str, option: str, value: str, folder: Path
) -> None:
    before = sorted(folder.rglob("*"))
    line = refusal(*words_of(name, folder), option, value)
    assert re.search(rf"(?<![\w-]){option}(?![\w-])", line), line
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    "words",
    [
        "simulate small.toml --to 13:00 --duration 1h",
        "simulate small.toml --set commitment.share=0.1,0.2",
        "simulate small.toml --page --orders",
        "simulate oahu --set time.duration_s=2590000 --set time.cycle_s=0.4",
        "launch small.toml --fault loss=1%",
        "launch small.toml --priority 20",
        "launch small.toml --set processes=cluster --cpus direct=0",
        "launch small.toml --address 10.1.2.3",
        "launch small.toml --keys keys/small",
        "launch small.toml --device c1/inv01=modbus://127.0.0.1/1",
        "launch small.toml --pace 1 --actuator fraction --device c1/inv01=modbus://h/1",
        "launch small.toml --pace 1 --device meter=modbus://127.0.0.1:1/1",
        "launch small.toml --external c1/inv01 --on 127.0.0.2=c1/*",
        "launch small.toml --on 127.0.0.2=c2 --on 127.0.0.3=c2/*",
        "launch small.toml --pace 1 --on 127.0.0.2=c1 --fault kill=c1,at=2s",
        "inspect run --cycle 3 --nodes c1",
        "export run",
        "export run --format mcap --nodes c1",
        "report run --report page",
        "replay run --without c1 --loop",
        "compare run",
        "diff run nowhere",
        "compare small.toml run",
        "compare small.toml --seeds 1,2 --report",
        "compare small.toml --seeds 1,2 --csv -",
        "compare small.toml --days 2010-04-01 --from 2010-04-01T12:00",
        "timing small.toml --rate 0.1..5 --duration 5s",
        "timing small.toml --rate 5..10 --out run",
        "timing timed --seed 3",
        "timing small.toml --rate 10 --duration 0.05",
        "node --plan here.json --host 127.0.0.2",
        "inverters small.toml --base-port 65534 --duration 1",
        "inverters small.toml --port 22000 --base-port 30000",
        "nonsense",
    ],
)
def test_options_that_do_not_go_together_are_refused(words: str, folder: Path) -> None:
    before = sorted(folder.rglob("*"))
    refusal(*words.split())
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("timing runs/typo", "runs/typo"),
        ("diff run runs/typo", "runs/typo"),
        ("simulate --set title=caf\udce9", "UTF-8"),
        ("keys small.toml --out=", "--out"),
        ("keys small.toml --out ", "--out"),
        ("inspect ", "an argument"),
        ("export run --format csv --nodes=", "--nodes"),
        ("simulate --out", "--out"),
        ("simulate a b", "'b'"),
        ("simulate --seed 1 --seed 2", "--seed"),
        ("lanch", "launch"),
        ("simulate --sceme paper", "--scheme"),
        ("simulate --scheme papre", "paper"),
        ("simulate oahuu", "oahu"),
        ("simulate hope-melpitz", "docs/data.md"),
        ("simulate small.toml --set comitment.share=0.3", "commitment"),
        ("inspect run --nodes c1/aa", "c1/a"),
        ("conform c9 --scenario small.toml", "AGENT"),
    ],
)
def test_a_mistyped_word_is_named_with_what_may_be_meant(
    words: str, named: str, folder: Path
) -> None:
    before = sorted(folder.rglob("*"))
    assert named in refusal(*words.split(" "))
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
        *((name, "--json") for name in ("simulate", "timing", "inspect", "compare")),
        ("simulate", "--report"),
        ("compare", "--report"),
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
@pytest.mark.parametrize("name", ["simulate", "timing", "scenarios", "inspect", "replay", "view"])
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


@pytest.mark.parametrize("name", ["simulate", "timing", "inspect", "replay", "compare", "view"])
def test_a_reader_who_leaves_is_no_error_message(
    name: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = words_of(name, folder)
    is_measured = name in {"timing", "compare"}
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

    def start(*words: str, cwd: Path) -> subprocess.Popen[str]:
        running.append(process(*words, cwd=cwd))
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
