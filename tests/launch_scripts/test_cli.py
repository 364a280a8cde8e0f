"""The command line as a whole: its help, its version and its completion."""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

import pytest
from command_line import done, heliarch, python

from agents.settings import Actuator, Scheme
from launch_scripts.app import COMMANDS
from launch_scripts.scenarios.scenario import shipped_scenarios
from studies.arrays.schemes import SCHEMES
from studies.metrics.figures_of_merit import FIGURES_OF_MERIT

REPOSITORY = Path(__file__).parents[2]
NAMES = [name for names in COMMANDS.values() for name in names]
MAIN = "from launch_scripts.cli import main; main()"
HEAVY = {"numba", "pandas", "plotly", "pvlib", "scipy", "zenoh"}


def help_of(command: str) -> str:
    text = done(command, "-h")
    assert text == done(command, "--help")
    return text


@pytest.mark.parametrize("name", NAMES)
def test_help_at_80_columns_shows_an_example_and_cuts_no_word(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("typer.rich_utils.MAX_WIDTH", 80)
    text = help_of(name)
    assert f"heliarch {name}" in text
    assert "Example: " in text
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize(
    ("command", "choices"),
    [
        ("launch", [*get_args(Scheme), *get_args(Actuator)]),
        ("compare", [*SCHEMES, *FIGURES_OF_MERIT]),
        ("export", ["json-mcap", "parquet", "csv", "wall", "sim"]),
        ("replay", ["wall", "sim"]),
    ],
)
def test_every_choice_is_listed(command: str, choices: list[str]) -> None:
    words = {word.strip("│,.:;[]<>()|") for word in help_of(command).replace("|", " ").split()}
    assert set(choices) <= words


@pytest.mark.parametrize("words", [["--help"], ["launch", "--help"], ["compare", "--help"]])
def test_help_does_not_wait_for_what_a_run_needs(words: list[str]) -> None:
    code = (
        "import sys\nfrom launch_scripts.cli import main\ntry:\n    main()\n"
        "except SystemExit:\n    print(*sys.modules, file=sys.stderr)"
    )
    found = python(code, *words)
    assert not HEAVY & {module.partition(".")[0] for module in found.stderr.split()}


def test_version_and_scenarios_are_told() -> None:
    assert heliarch("--version").stdout.startswith("heliarch ")
    found = json.loads(heliarch("scenarios", "--json", "-").stdout)
    assert {entry["name"] for entry in found} == set(shipped_scenarios())


@pytest.mark.parametrize(
    ("typed", "offered"),
    [("heliarch re", {"report", "replay", "recover"}), ("heliarch launch --sc", {"--scheme"})],
)
def test_the_shell_completes_commands_and_options(typed: str, offered: set[str]) -> None:
    code = f"import sys; sys.argv = ['heliarch']; {MAIN}"
    completion = {
        "_HELIARCH_COMPLETE": "complete_bash",
        "COMP_WORDS": typed,
        "COMP_CWORD": str(typed.count(" ")),
    }
    assert set(python(code, variables=completion).stdout.split()) == offered


def test_a_terminal_without_the_lines_of_a_tree_gets_the_rest() -> None:
    run = REPOSITORY / "recordings" / "golden" / "oahu-limit"
    words = ("inspect", run, "--cycle", "3")
    assert "central" in python(MAIN, *words, variables={"PYTHONIOENCODING": "ascii"}).stdout


def test_a_command_needs_no_standard_output() -> None:
    assert python(f"import sys; sys.stdout = None; {MAIN}", "scenarios").stderr == ""


def test_doctor_finds_what_would_stop_a_run_and_says_what_to_do_about_it() -> None:
    code = f"import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (120, 120)); {MAIN}"
    document = python(code, "doctor", "--json", "-", status=1).stdout
    found = {finding["about"]: finding for finding in json.loads(document)}
    assert found["open files"]["verdict"] == "wrong"
    assert "ulimit" in found["open files"]["advice"]
    assert found["policy"]["found"].startswith("SCHED_")
    assert all(finding["advice"] for finding in found.values() if finding["verdict"] != "ok")
