"""`heliarch compare`: its tables, its JSON, its page, and what it refuses."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from command_line import done, refusal
from recorded_runs import plan_of
from recordings_by_hand import PLAN, whole_run, write_run
from running import small_plant

from bus_schemas.bus import Delivery
from bus_schemas.messages import Production

GROUPS = ("--schemes", "paper,grouping", "--reference", "inv01,inv03")


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> str:
    return small_plant(tmp_path_factory.mktemp("compare"))


def test_one_case_is_a_table_and_a_page_with_each_scheme_and_actuator(
    small: str, tmp_path: Path
) -> None:
    page, document = tmp_path / "compare.html", tmp_path / "rows.json"
    words = ("--actuator", "limit,fraction", "--report", page, "--json", document)
    text = done("compare", small, "--duration", "60", "--schemes", "paper,uncontrolled", *words)
    assert "Regulation signal" not in text
    rows = [line.split()[:2] for line in text.splitlines()]
    expected = [["paper", "limit"], ["paper", "fraction"], ["uncontrolled", "-"]]
    assert all(row in rows for row in expected)
    assert 'id="frontier-plot"' in page.read_text(encoding="utf-8")
    found = [(row["scheme"], row["actuator"]) for row in json.loads(document.read_bytes())]
    assert found == [("paper", "limit"), ("paper", "fraction"), ("uncontrolled", None)]


def test_a_regulation_signal_adds_the_second_table() -> None:
    words = ("--from", "10:00", "--duration", "60", "--schemes", "paper")
    assert "Regulation signal" in done("compare", "oahu-day", *words)


def test_many_cases_have_a_row_each_and_a_summary_as_csv(small: str, tmp_path: Path) -> None:
    summary, document = tmp_path / "summary.csv", tmp_path / "rows.json"
    words = ("--set", "commitment.share=0.3,0.5", "--seeds", "1,2", "--show", "rmse", *GROUPS)
    text = done("compare", small, "--duration", "60", *words, "--json", document, "--csv", summary)
    assert all(f"share={share}" in text for share in ("0.3", "0.5"))
    cases = json.loads(document.read_bytes())
    assert [(row["case"], row["scheme"]) for row in cases] == [
        (f"share={share} seed={seed}", scheme)
        for share in ("0.3", "0.5")
        for seed in (1, 2)
        for scheme in ("paper", "grouping")
    ]
    rmse = [row["rmse"] for row in cases if row["scheme"] == "paper"]
    rows = csv.DictReader(summary.open(encoding="utf-8"))
    means = [row for row in rows if (row["figure"], row["scheme"]) == ("rmse", "paper")]
    assert [row["cases"] for row in means] == ["2", "2"]
    assert float(means[0]["mean"]) == pytest.approx(sum(rmse[:2]) / 2.0)


# Two recorded runs --------------------------------------------------------------------------------


def with_production(cycles: int, cycle: int, **fields: tuple[float, ...]) -> Iterator[Delivery]:
    """A run by hand with another production in one cycle."""
    for port, message in whole_run(cycles):
        if isinstance(message, Production) and message.cycle == cycle:
            message = msgspec.structs.replace(message, **fields)  # noqa: PLW2901
        yield port, message


@pytest.fixture
def runs(tmp_path: Path) -> tuple[Path, Path]:
    """Two recordings: in the second `c2/c` gives 55 in place of 60 kW in cycle 7."""
    first, second = tmp_path / "first", tmp_path / "second"
    for folder in (first, second):
        folder.mkdir()
    write_run(first / "run.mcap", whole_run(20))
    less = with_production(20, 7, inverter_power_kw=(40.0, 80.0, 55.0, 59.0))
    write_run(second / "run.mcap", less)
    return first, second


def test_two_runs_stand_side_by_side_with_their_first_difference(
    runs: tuple[Path, Path], tmp_path: Path
) -> None:
    document, page = tmp_path / "runs.json", tmp_path / "runs.html"
    done("compare", runs[0], runs[1] / "run.mcap", "--json", document, "--report", page)
    found = json.loads(document.read_bytes())
    (difference,) = found["differences"]
    assert (difference["message"], difference["node"]) == ("production, power", "c2/c")
    assert (difference["cycle"], difference["time"]) == (7, "12:00:07")
    assert (difference["A"], difference["B"]) == (60.0, 55.0)
    delivered = {row["figure"]: row for row in found["figures"]}["Delivered energy"]
    # 239 kW for 20 s, and 5 kW less for one of them.
    assert delivered["A"] == pytest.approx(239.0 * 20.0 / 3600.0)
    assert delivered["difference"] == pytest.approx(-5.0 / 3600.0)
    html = page.read_text(encoding="utf-8")
    assert "delivered, A" in html
    assert "delivered, B" in html


def test_a_reader_is_told_that_the_sky_differs(runs: tuple[Path, Path], tmp_path: Path) -> None:
    document, other = tmp_path / "runs.json", tmp_path / "other.mcap"
    write_run(other, with_production(20, 3, inverter_mpp_kw=(40.0, 95.0, 75.0, 75.0)))
    assert "Sky or dispatch differ" in done("compare", runs[1], other)
    done("compare", runs[1], other, "--json", document)
    first, second = json.loads(document.read_bytes())["differences"]
    assert (first["message"], first["node"], first["cycle"]) == ("production, maximum", "c1/b", 3)
    assert (second["message"], second["cycle"]) == ("production, power", 7)


def test_runs_that_are_the_same_as_far_as_both_go_say_so(
    runs: tuple[Path, Path], tmp_path: Path
) -> None:
    short = tmp_path / "short.mcap"
    write_run(short, whole_run(6))
    text = done("compare", runs[1], short)
    assert "first 6 are compared" in text
    assert "bit for bit" in text
    assert "production, power" not in text


def test_cycles_that_one_run_has_not_recorded_are_left_out_of_both(
    runs: tuple[Path, Path], tmp_path: Path
) -> None:
    document, gap = tmp_path / "runs.json", tmp_path / "gap.mcap"
    write_run(gap, whole_run(20), is_kept=lambda pair: not 5 <= pair[1].cycle < 9)
    text = done("compare", runs[1], gap, "--json", document)
    assert "4 of 20 cycles" in " ".join(text.split())
    found = json.loads(document.read_bytes())
    assert found["differences"] == [], "they differ in cycle 7 alone"
    delivered = {row["figure"]: row for row in found["figures"]}["Delivered energy"]
    assert delivered["A"] == delivered["B"] == pytest.approx(239.0 * 16.0 / 3600.0)


def test_what_are_no_two_runs_of_one_plant_is_refused(
    runs: tuple[Path, Path], tmp_path: Path, small: str
) -> None:
    other = tmp_path / "other.mcap"
    write_run(other, [], plan=plan_of(start_time_ns=PLAN.start_time_ns))
    later = tmp_path / "later.mcap"
    plan = msgspec.structs.replace(PLAN, start_time_ns=PLAN.start_time_ns + 10**9)
    write_run(later, whole_run(20), plan=plan)
    assert "second run" in refusal("compare", runs[0])
    assert "nowhere" in refusal("compare", runs[0], "nowhere")
    assert "recorded run" in refusal("compare", small, runs[0])
    assert "oahu" in refusal("compare", runs[0], "oahu")
    renamed = tmp_path / "renamed.mcap"
    inverters = tuple((f"{path}2", rating_kw) for path, rating_kw in PLAN.inverters)
    of_plant = [(port, message) for port, message in whole_run(20) if not port.node]
    write_run(renamed, of_plant, plan=msgspec.structs.replace(PLAN, inverters=inverters))
    for second in (later, renamed):
        line = refusal("compare", runs[0], second)
        assert line.startswith(f"heliarch: {second}: expected ")
        assert str(runs[0]) in line
    assert "--seeds" in refusal("compare", *runs, "--seeds", "1,2")
    assert "cycle" in refusal("compare", runs[0], other)
