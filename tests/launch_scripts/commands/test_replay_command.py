"""`heliarch replay` as a user types it, where it needs no other process."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import msgspec
import pytest
from replayed_runs import PLAN, run_in_memory, write
from typer.testing import CliRunner, Result

from launch_scripts.cli import app

SAID = run_in_memory()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run of 40 cycles."""
    return write(tmp_path_factory.mktemp("replay") / "run", SAID)


def replay(*words: str | Path) -> Result:
    """Run the command in this process."""
    return CliRunner().invoke(app, ["replay", *map(str, words)])


def refused(*words: str | Path) -> str:
    """The one line with which it refuses."""
    result = replay(*words)
    assert result.exit_code == 2, result.output
    (line,) = result.stderr.splitlines()
    return line


def test_it_says_where_subscribers_connect_and_what_it_came_to(recorded: Path) -> None:
    result = replay(recorded)
    assert result.exit_code == 0, result.output
    assert "endpoint tcp/127.0.0.1:" in result.stdout
    assert "keys recorded-1/field/**" in result.stdout
    assert f"replayed {len(SAID):,} messages of 40 cycles" in result.stdout
    assert "timing error, sent less due: p50" in result.stdout


def test_the_figures_go_to_standard_output_alone_if_asked_for(recorded: Path) -> None:
    result = replay(recorded, "--json", "-", "--duration", "4", "--from", "12:00:10")
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    wanted = sum(10 <= entry.message.cycle < 14 for entry in SAID)
    assert (figures["messages"], figures["cycles"]) == (wanted, 4)
    assert figures["timing_error"]["count"] == wanted
    assert figures["timing_error"]["max_us"] >= figures["timing_error"]["p50_us"] >= 0.0
    assert "endpoint" in result.stderr


def test_as_fast_as_possible_nothing_is_due(recorded: Path, tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    result = replay(recorded, "--rate", "0", "--json", path)
    assert result.exit_code == 0, result.output
    assert json.loads(path.read_bytes())["timing_error"] is None
    assert "timing error" not in result.stdout


def test_spaced_by_simulated_time_a_cycle_takes_its_second(recorded: Path) -> None:
    result = replay(
        recorded, "--clock", "sim", "--rate", "20", "--duration", "11", "--signals", "dispatch",
        "--json", "-",
    )  # fmt: skip
    figures = json.loads(result.stdout)
    assert figures["messages"] == 11
    assert figures["wall_s"] >= 10 / 20


def test_a_recording_that_was_cut_is_replayed_up_to_the_cut(recorded: Path, tmp_path: Path) -> None:
    content = (recorded / "run.mcap").read_bytes()
    cut = tmp_path / "run.mcap"
    cut.write_bytes(content[: len(content) // 2])
    result = replay(cut, "--rate", "0")
    assert result.exit_code == 0, result.output
    assert "cut short: replayed up to the cut (`heliarch recover`" in result.stdout


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--rate", "-1"], "--rate -1: accepted is a number from 0"),
        (["--rate", "nan"], "--rate nan: accepted is a number from 0"),
        (["--clock", "moon"], "--clock moon: accepted are wall (as recorded) and sim"),
        (["--from", "12:30:00"], "--start-offset 12:30:00: outside the run"),
        (["--from", "noon"], "--start-offset noon: not understood"),
        (["--duration", "-3"], "--duration: expected seconds above 0"),
        (["--signals", "imp"], "near are impp"),
        (["--listen", "7447"], "--listen 7447: accepted is an address such as tcp/127.0.0.1:7447"),
        (["--listen", "tcp/127.0.0.1:99999"], "--listen tcp/127.0.0.1:99999: "),
        (["--namespace", "a*"], "--namespace 'a*': accepted are names"),
        (["--start-paused"], "--start-paused: accepted in a terminal"),
        (["--plan", "plan.json"], "--plan: accepted with --live"),
        (["--live", "c1/x"], "--live: node 'c1/x': not in this run, near are c1/"),
        (["--live", "plant"], "--live: node 'plant': not in this run"),
        (["--live", "c1", "--rate", "2"], "--rate: not accepted with --live"),
        (["--live", "c1", "--loop"], "--loop: not accepted with --live"),
        (["--live", "c1", "--from", "9"], "--start-offset: not accepted with --live"),
    ],
)
def test_words_that_make_no_sense_are_refused_in_one_line(
    recorded: Path, words: list[str], complaint: str
) -> None:
    assert complaint in refused(recorded, *words)


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    assert "no such file" in refused(tmp_path)


def test_an_address_that_is_taken_is_refused(recorded: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        line = refused(recorded, "--listen", endpoint)
    assert line.startswith(f"heliarch: --listen {endpoint}: ")
    assert "accepted is a free address" in line


def test_a_plan_of_another_plant_is_refused(recorded: Path, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.write_bytes(msgspec.structs.replace(PLAN, period_cycles=(1, 1)).as_json())
    assert refused(recorded, "--live", "c1", "--plan", path) == (
        f"heliarch: {path}: period_cycles is (1, 1), accepted is that of the recorded run, (2, 1)"
    )


def test_a_place_for_the_figures_that_is_none_is_refused(recorded: Path, tmp_path: Path) -> None:
    assert "accepted is a file" in refused(recorded, "--json", tmp_path / "nowhere" / "f.json")


def test_the_help_shows_an_example_within_its_columns() -> None:
    text = replay("--help").stdout
    assert "Example: heliarch replay" in text
    assert max(map(len, text.splitlines())) <= 100
