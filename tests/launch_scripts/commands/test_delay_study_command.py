"""`heliarch timing --study`: tables, JSON and page, and what it refuses."""

from __future__ import annotations

import contextlib
import dataclasses
import re
import signal
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from io import StringIO
from pathlib import Path
from typing import Final, get_args

import msgspec
import pytest
from msgspec.structs import replace
from rich.console import Console

from agents.plan import Scheme
from launch_scripts.commands import delays as delay_study_command
from launch_scripts.commands.delays import StudyRequest
from launch_scripts.commands.timing import STUDY_PAGE_NAME, studied
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from studies.delays import study as delay_study
from studies.delays.study import Outcome, Trouble
from studies.delays.table import print_study, survived

FULL: Final = Path("/dev/full")


def outcome(
    trouble: Trouble, value: float, shortfall: float | None, scheme: Scheme = "paper"
) -> Outcome:
    return Outcome(
        trouble=trouble,
        value=value,
        scheme=scheme,
        control_caused_percent=shortfall,
        over_delivered_percent=0.0,
        mileage_kw_per_h=100.0,
        fulfilled_percent=None,
        score=None,
        missed_percent=0.0,
        old_inputs=0,
        lost=0,
    )


@pytest.fixture(scope="module")
def prepared() -> Preparation:
    return prepare(load_scenario("oahu"), RunOptions(duration="300"), "study")


def test_what_is_survived_is_told_up_to_the_first_value_that_costs_too_much() -> None:
    found = survived(
        [
            outcome("delay", 0.0, 0.1),
            outcome("delay", 0.2, 0.99),
            outcome("delay", 0.5, 1.0),
            outcome("delay", 1.0, 0.5),
            outcome("loss", 0.0, 2.0),
            outcome("period", 1.0, None),
        ]
    )
    assert found[0] == (
        "paper: the shortfall that control causes stays below 1 % of the desired energy at delay "
        "of each hop up to 0.2 s, no lost messages, no central period"
    )


WORST: list[tuple[Trouble, float]] = [
    ("delay", 0.05),
    ("delay", 10.0),
    ("loss", 0.5),
    ("period", 60.0),
]


@pytest.mark.parametrize("width", [80, 100, 120])
def test_no_heading_unit_or_figure_is_cut(width: int, prepared: Preparation) -> None:
    outcomes = [
        replace(
            outcome(trouble, value, 23.456, scheme),
            over_delivered_percent=12.345,
            mileage_kw_per_h=133376.0,
            fulfilled_percent=100.0,
            old_inputs=123456,
        )
        for trouble, value in WORST
        for scheme in get_args(Scheme)
    ]
    console = Console(width=width, file=StringIO())
    print_study(prepared, outcomes, console)
    assert isinstance(console.file, StringIO)
    printed = console.file.getvalue()
    tables = printed.partition("every hop delayed")[2]
    assert "…" not in printed
    for word in ("predictive", "delivered", "fulfilled", "[kW/h]", "absent"):
        assert word in tables
    for unit in ("delay of each hop [s]", "lost messages [%]", "central period [s]"):
        assert f": {unit}, scheme" in " ".join(printed.split())
    assert tables.count("23.456") == tables.count("133,376") == tables.count("123,456") == 8


def test_the_page_is_not_taken_for_a_file_of_the_repository() -> None:
    ignored = (Path(__file__).parents[3] / ".gitignore").read_text(encoding="utf-8").splitlines()
    assert "/*.html" in ignored
    assert Path(STUDY_PAGE_NAME).match("*.html")
    assert Path(STUDY_PAGE_NAME).parent == Path(), "it is written into the working folder"


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """A study of few values."""
    values = {"delay": (0.0, 0.5)}
    monkeypatch.setattr(delay_study, "VALUES", values)


def test_tables_json_and_page_tell_the_same(
    few: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    json, page = tmp_path / "study.json", tmp_path / "new" / "study.html"
    request = StudyRequest(
        "oahu-day",
        "12:00",
        "150",
        settings=("commitment.share=0.6",),
        workers=1,
        json=str(json),
        page=page,
    )
    assert studied(request) == 0
    printed = capsys.readouterr().out
    document = msgspec.json.decode(json.read_bytes())
    assert document["cycles"] == 150
    assert document["settings"] == ["commitment.share=0.6"]
    assert len(document["outcomes"]) == 2 * 2
    worst = document["outcomes"][2]
    assert (worst["value"], worst["scheme"]) == (0.5, "paper")
    shortfall = f"{worst['control_caused_percent']:.3f}"
    assert re.search(rf"0\.5 paper +{re.escape(shortfall)} ", printed)
    text = page.read_text()
    assert f'<td class="number">{shortfall}</td>' in text
    assert '<div class="plot" id="study-plot"' in text
    assert "150 cycles of 1 s" in text
    assert "paper: the shortfall that control causes stays below 1 % of" in printed


@pytest.mark.parametrize(
    ("request_", "complaint"),
    [
        (StudyRequest(workers=0), "--workers 0: accepted are 1 to 256"),
        (StudyRequest(json="/nowhere/at/all.json"), "expected a file in an existing folder"),
        (StudyRequest(page=Path(__file__) / "page.html"), "accepted is a file in a folder"),
        (StudyRequest("absent", duration="2m"), "--duration 2m: accepted for a study is more than"),
        (StudyRequest("oahu", settings=("a.b=1,2",)), "--set a.b=1,2: accepted is one value"),
        (
            StudyRequest("oahu", settings=("faults=[{loss = 0.1}]",)),
            "faults, accepted for a study is a scenario without: it brings its own",
        ),
    ],
)
def test_what_it_cannot_study_is_refused_in_one_line(
    request_: StudyRequest, complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert studied(request_) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert error.count("\n") == 1


@pytest.fixture
def done(monkeypatch: pytest.MonkeyPatch) -> StudyRequest:
    """A study whose conditions are run in no time."""
    found = [
        (number, outcome(trouble, value, 0.1)) for number, (trouble, value) in enumerate(WORST)
    ]
    monkeypatch.setattr(delay_study_command, "run_study_over", lambda *_: iter(found))
    return StudyRequest("oahu-day", "12:00", "150", workers=1)


@pytest.mark.skipif(not FULL.exists(), reason="this system has no device that is full")
def test_a_file_that_cannot_be_written_costs_neither_tables_nor_page(
    done: StudyRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    json, page = tmp_path / "study.json", tmp_path / "study.html"
    json.symlink_to(FULL)  # Code that replaces what it should write to takes the link alone.
    request = dataclasses.replace(done, json=str(json), page=page)
    assert studied(request) == 1
    printed = capsys.readouterr()
    assert "every hop delayed" in printed.out
    assert printed.err == f"heliarch: not written: {json}: No space left on device\n"
    assert "</html>" in page.read_text()


def test_a_page_whose_folder_cannot_be_made_is_told(
    done: StudyRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = tmp_path / "new" / "study.html"

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "mkdir", full)
    assert studied(dataclasses.replace(done, page=page)) == 1
    assert capsys.readouterr().err == f"heliarch: not written: {page}: No space left on device\n"


@pytest.mark.parametrize(
    ("signum", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)]
)
def test_a_signal_ends_it_in_one_line(
    signum: signal.Signals,
    status: int,
    done: StudyRequest,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def signalled(*_: object) -> Iterator[tuple[int, Outcome]]:
        yield 0, outcome("delay", 0.0, 0.1)
        signal.raise_signal(signum)

    monkeypatch.setattr(delay_study_command, "run_study_over", signalled)
    assert studied(done) == status
    printed = capsys.readouterr()
    assert printed.err == "heliarch: interrupted\n"
    assert "every hop delayed" not in printed.out


def test_a_signal_that_reaches_the_workers_too_is_no_lack_of_memory(
    done: StudyRequest, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def signalled(*_: object) -> Iterator[tuple[int, Outcome]]:
        yield 0, outcome("delay", 0.0, 0.1)
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        raise BrokenProcessPool

    monkeypatch.setattr(delay_study_command, "run_study_over", signalled)
    assert studied(done) == 143
    assert capsys.readouterr().err == "heliarch: interrupted\n"


def test_a_signal_while_the_tables_are_printed_cuts_nothing(
    done: StudyRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    json = tmp_path / "study.json"
    monkeypatch.setattr(
        delay_study_command, "print_study", lambda *_: signal.raise_signal(signal.SIGTERM)
    )
    assert studied(dataclasses.replace(done, json=str(json))) == 143
    assert len(msgspec.json.decode(json.read_bytes())["outcomes"]) == len(WORST)
