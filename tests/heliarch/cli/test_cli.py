"""The command line as a whole: its help, its version and its completion."""

from __future__ import annotations

import io
import json
import shlex
from pathlib import Path

import pytest
from command_line import done, heliarch, python, refusal
from plans_by_hand import plan_at_noon
from rich.console import Console

from agents.process.events import Status
from bus_schemas.errors import listed
from heliarch.cli.app import COMMANDS
from heliarch.cli.live_view import PlainView
from results.tables import Table, key_column, print_table
from scenarios.scenario import shipped_scenarios
from studies.arrays.schemes import SCHEMES

NAMES = [name for names in COMMANDS.values() for name in names]
MAIN = "from heliarch.cli.main import main; main()"
HOSTILE = "power[/kw] \x1b[2J\x1b]0;owned\x07 \x9b31m [/red] [bold]"
HEAVY = {"numba", "pandas", "plotly", "pvlib", "scipy", "zenoh"}


def help_of(command: str) -> str:
    text = done(command, "-h")
    assert text == done(command, "--help")
    return text


@pytest.mark.parametrize("name", NAMES)
def test_help_at_80_columns_shows_an_example_and_cuts_no_word(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = help_of(name)
    assert f"heliarch {name}" in text
    assert "Example: " in text
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= 80


def test_help_describes_each_command_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert done("-h") == done("--help")
    lines = [line.strip("│ ") for line in done("-h").splitlines() if line.startswith("│ ")]
    described = dict(line.split(None, 1) for line in lines if not line.startswith("--"))
    assert sorted(described) == sorted(NAMES)
    assert all(text.endswith(".") for text in described.values())


def test_the_help_of_compare_lists_every_scheme() -> None:
    assert {*SCHEMES} <= {word.strip("│,.:") for word in help_of("compare").split()}


def test_a_file_that_the_user_did_not_name_is_no_bad_input(tmp_path: Path) -> None:
    assert heliarch("inspect", tmp_path / "none").exit_code == 2
    assert heliarch("init", "positions.csv", "ghi.csv", "--out", tmp_path / "x.toml").exit_code == 2
    own = "open('/nowhere/of/heliarch')"
    code = f"import heliarch.cli.scenarios as s\ns.Output = lambda *_: {own}\n{MAIN}"
    failed = python(code, "scenarios", status=1)
    assert failed.stderr == "heliarch: /nowhere/of/heliarch: No such file or directory\n"
    assert "Traceback" in python(code, "scenarios", "--debug", status=1).stderr


@pytest.mark.parametrize(
    ("package", "extra", "words"),
    [
        ("numba", "compare", ["compare", "oahu", "--duration", "60"]),
        ("plotly", "report", ["simulate", "oahu", "--report", "--out", "run"]),
        ("plotly", "report", ["report", "run"]),
        ("pyarrow", "tables", ["export", "run", "--format", "csv"]),
    ],
)
def test_a_command_without_its_package_names_the_extra(
    package: str, extra: str, words: list[str], tmp_path: Path
) -> None:
    done("simulate", "oahu", "--duration", "5", "--out", tmp_path / "run")
    hidden = (
        "import sys\nclass Hidden:\n    def find_spec(self, name, path=None, target=None):\n"
        f"        if name.partition('.')[0] == {package!r}:\n"
        "            raise ModuleNotFoundError(name, name=name)\n"
        "sys.meta_path.insert(0, Hidden())\n"
    )
    if words[0] == "simulate":  # It asks whether the package is there.
        hidden = f"import sys\nsys.modules[{package!r}] = None\n"
    refused = python(hidden + MAIN, *words, cwd=tmp_path, status=2)
    (line,) = refused.stderr.splitlines()
    assert f"needs {package}: pip install 'heliarch[{extra}]'" in line


def test_an_unexpected_error_is_one_line_and_its_traceback_is_asked_for() -> None:
    code = f"import heliarch.cli.scenarios as s\ns.Output = lambda *_: 1 / 0\n{MAIN}"
    failed = python(code, "scenarios", status=1)
    assert failed.stderr.startswith("heliarch: unexpected ZeroDivisionError")
    assert len(failed.stderr.splitlines()) == 1
    assert "Traceback" in python(code, "--debug", "scenarios", status=1).stderr


@pytest.mark.parametrize("words", [["--help"], ["launch", "--help"], ["compare", "--help"]])
def test_help_does_not_wait_for_what_a_run_needs(words: list[str]) -> None:
    code = (
        "import sys\nfrom heliarch.cli.main import main\ntry:\n    main()\n"
        "except SystemExit:\n    print(*sys.modules, file=sys.stderr)"
    )
    found = python(code, *words)
    assert not HEAVY & {module.partition(".")[0] for module in found.stderr.split()}


def test_version_and_shipped_scenarios_are_listed() -> None:
    assert heliarch("--version").stdout.startswith("heliarch ")
    found = json.loads(heliarch("scenarios", "--json", "-").stdout)
    assert {entry["name"] for entry in found} == set(shipped_scenarios())


def test_too_little_memory_is_said_in_one_line() -> None:
    limit = "resource.setrlimit(resource.RLIMIT_AS, (400_000_000,) * 2)"
    found = python(f"import resource; {limit}; {MAIN}", "scenarios", status=1)
    (line,) = found.stderr.splitlines()
    assert "ulimit -v" in line


def test_doctor_finds_what_would_stop_a_run_and_says_what_to_do_about_it() -> None:
    code = f"import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (120, 120)); {MAIN}"
    document = python(code, "doctor", "--json", "-", status=1).stdout
    found = {finding["about"]: finding for finding in json.loads(document)}
    assert found["open files"]["verdict"] == "wrong"
    assert "ulimit" in found["open files"]["advice"]
    assert all(finding["advice"] for finding in found.values() if finding["verdict"] != "ok")


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_launched_run_shows_names_with_markup_and_escapes_as_text(is_terminal: bool) -> None:
    output = io.StringIO()
    console = Console(file=output, force_terminal=is_terminal, width=200, color_system=None)
    PlainView(console, plan_at_noon()).say(HOSTILE)
    print_table(console, Table(HOSTILE, (key_column("key"),), ((HOSTILE,),), (HOSTILE,)))
    shown = output.getvalue()
    assert all(text in shown for text in ("power[/kw]", "[/red] [bold]"))
    assert not any(text in shown for text in ("\x9b", "\x1b]", "\x1b[2J"))


@pytest.mark.parametrize("width", range(60, 130, 7))
def test_the_progress_of_a_run_fits_into_its_terminal_and_cuts_nothing(width: int) -> None:
    output = io.StringIO()
    console = Console(file=output, force_terminal=True, width=width, color_system=None)
    plan = plan_at_noon()
    names = ["c1", "c1/inverter07", "c2/inverter11"]
    start_ns = plan.timing.start_time_ns
    PlainView(console, plan).show(Status(29, start_ns, 3508.0, 4684.0, 3508.0, names, 0))
    shown = output.getvalue().removeprefix("\r\x1b[K")
    assert len(shown) < width
    powers, _, helped = shown.partition("; help: ")
    whole = "dispatch 3508 kW", "delivered 3508 kW", "available 4684 kW"
    assert set(powers.split(", ")[1:]) <= set(whole)
    assert helped in {"", "3 nodes", *(listed(names, most) for most in (1, 2, 3))}


def test_the_commands_for_what_comes_next_can_be_typed(plant: str, tmp_path: Path) -> None:
    run = tmp_path / "of today; and more"
    said = done("simulate", plant, "--duration", "5", "--out", str(run))
    after = said.partition("next:")[2].splitlines()
    (words,) = [words for words in map(shlex.split, after) if "inspect" in words]
    assert words[words.index("inspect") + 1] == str(run)


def test_a_link_to_nothing_is_no_folder_for_a_run(plant: str, tmp_path: Path) -> None:
    (tmp_path / "run").symlink_to(tmp_path / "nowhere")
    line = refusal("simulate", plant, "--duration", "5", "--out", str(tmp_path / "run"))
    assert "--out" in line
    assert not (tmp_path / "nowhere").exists()
