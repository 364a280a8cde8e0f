"""`heliarch timing --study`: tables, JSON and page, and what it refuses."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec
import pytest

from agents.plan import Scheme
from launch_scripts.timing import delay_study
from launch_scripts.timing.delay_study import Outcome, Trouble
from launch_scripts.timing.delay_study_command import StudyRequest, run_study
from launch_scripts.timing.delay_study_table import survived


def outcome(
    trouble: Trouble, value: float, shortfall: float | None, scheme: Scheme = "paper"
) -> Outcome:
    return Outcome(
        trouble=trouble,
        value=value,
        scheme=scheme,
        late="use",
        control_caused_percent=shortfall,
        over_delivered_percent=0.0,
        mileage_kw_per_h=100.0,
        fulfilled_percent=None,
        score=None,
        missed_percent=0.0,
        late_used=0,
        lost=0,
    )


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
        "paper: control causes less than 1 % of shortfall at delay of each hop up to 0.2 s, no "
        "lost messages, no central period"
    )


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
    assert run_study(request) == 0
    printed = capsys.readouterr().out
    document = msgspec.json.decode(json.read_bytes())
    assert document["cycles"] == 150
    assert document["settings"] == ["commitment.share=0.6"]
    assert len(document["outcomes"]) == 2 * 2 * 2
    worst = document["outcomes"][4]
    assert (worst["value"], worst["scheme"], worst["late"]) == (0.5, "paper", "use")
    shortfall = f"{worst['control_caused_percent']:.3f}"
    assert re.search(rf"0\.5 │ paper +│ use +│ +{re.escape(shortfall)} │", printed)
    text = page.read_text()
    assert f'<td class="number">{shortfall}</td>' in text
    assert '<div class="plot" id="study-plot"' in text
    assert "150 cycles of 1 s" in text
    assert "paper: control causes less than 1 % of shortfall" in printed


@pytest.mark.parametrize(
    ("request_", "complaint"),
    [
        (StudyRequest(workers=0), "--workers 0: accepted are 1 to 256"),
        (StudyRequest(json="/nowhere/at/all.json"), "accepted is a file in an existing folder"),
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
    assert run_study(request_) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert error.count("\n") == 1
