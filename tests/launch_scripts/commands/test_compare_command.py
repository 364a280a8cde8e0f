"""`heliarch compare`: its tables, its JSON, its page, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import done, refusal
from running import small_plant

GROUPS = ("--schemes", "paper,grouping", "--reference", "inv01,inv03")


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> str:
    return small_plant(tmp_path_factory.mktemp("compare"))


def test_one_case_has_a_row_for_each_scheme_and_a_page(small: str, tmp_path: Path) -> None:
    page = tmp_path / "compare.html"
    text = done("compare", small, "--duration", "60", *GROUPS, "--report", page)
    names = [line.split(" ")[0] for line in text.splitlines()]
    assert {"paper", "grouping"} <= set(names)
    assert "Regulation signal" not in text
    html = page.read_text(encoding="utf-8")
    assert "paper" in html
    assert "grouping" in html


def test_a_regulation_signal_adds_the_second_table() -> None:
    words = ("--from", "10:00", "--duration", "60", "--schemes", "paper")
    assert "Regulation signal" in done("compare", "oahu-day", *words)


def test_many_cases_show_one_figure_with_a_row_for_each(small: str, tmp_path: Path) -> None:
    document = tmp_path / "rows.json"
    settings = ("--set", "commitment.share=0.3,0.5", "--show", "rmse", "--json", document)
    text = done("compare", small, "--duration", "60", *GROUPS, *settings)
    assert all(f"share={share}" in text for share in ("0.3", "0.5"))
    rows = json.loads(document.read_bytes())
    assert [(row["case"], row["scheme"]) for row in rows] == [
        (f"share={share}", scheme) for share in ("0.3", "0.5") for scheme in ("paper", "grouping")
    ]
    assert all(row["control-caused"] >= 0.0 for row in rows)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--schemes", "magic"), "--schemes"),
        (("--show", "beauty"), "--show"),
        (("--workers", "0"), "--workers"),
        (("--reference", "few"), "--reference"),
        (("--seeds", "x"), "--seeds"),
        (("--days", "x"), "--days"),
        (("--set", "x"), "--set"),
        (("--seeds", "1,2", "--report"), "--report"),
        (("--days", "2010-04-01", "--from", "2010-04-01T12:00"), "--from"),
    ],
)
def test_what_it_cannot_compare_is_refused(words: tuple[str, ...], named: str, small: str) -> None:
    assert named in refusal("compare", small, "--duration", "20", *words)
