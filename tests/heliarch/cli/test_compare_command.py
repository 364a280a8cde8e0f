"""`heliarch compare`: its tables, its JSON, its page, and what it refuses."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec
import pytest
from command_line import done, refusal
from plans_by_hand import with_changes
from recorded_runs import plan_of
from recordings_by_hand import PLAN, whole_run, write_run
from running import small_plant

from bus_schemas.bus import Delivery
from bus_schemas.messages import Production


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> str:
    return small_plant(tmp_path_factory.mktemp("compare"))


def test_one_case_is_a_table_and_a_page_with_each_scheme_and_actuator(
    small: str, tmp_path: Path
) -> None:
    page, document = tmp_path / "compare.html", tmp_path / "rows.json"
    words = ("--actuator", "limit,fraction", "--report", page, "--json", document)
    text = done("compare", small, "--duration", "60", "--schemes", "paper,uncontrolled", *words)
    rows = [line.split()[:2] for line in text.splitlines()]
    expected = [["paper", "limit"], ["paper", "fraction"], ["uncontrolled", "-"]]
    assert all(row in rows for row in expected)
    assert 'id="frontier-plot"' in page.read_text(encoding="utf-8")
    found = [(row["scheme"], row["actuator"]) for row in json.loads(document.read_bytes())]
    assert found == [("paper", "limit"), ("paper", "fraction"), ("uncontrolled", None)]


def test_one_case_shows_regulation_and_what_faults_did() -> None:
    words = "oahu-day --from 10:00 --duration 60 --fault loss=50% --schemes paper"
    text = done("compare", *words.split())
    assert all(title in text for title in ("Regulation signal", "Help, missed inputs and reverts"))


def test_many_cases_have_a_row_each_and_a_summary_as_csv(small: str, tmp_path: Path) -> None:
    summary, document = tmp_path / "summary.csv", tmp_path / "rows.json"
    schemes = ("--schemes", "paper,uniform-cap")
    words = ("--set", "commitment.share=0.3,0.5", "--seeds", "1,2", "--show", "rmse", *schemes)
    text = done("compare", small, "--duration", "60", *words, "--json", document, "--csv", summary)
    assert all(f"share={share}" in text for share in ("0.3", "0.5"))
    cases = json.loads(document.read_bytes())
    assert [(row["case"], row["scheme"]) for row in cases] == [
        (f"share={share} seed={seed}", scheme)
        for share in ("0.3", "0.5")
        for seed in (1, 2)
        for scheme in ("paper", "uniform-cap")
    ]
    rmse = [row["rmse"] for row in cases if row["scheme"] == "paper"]
    rows = csv.DictReader(summary.open(encoding="utf-8"))
    means = [row for row in rows if (row["figure"], row["scheme"]) == ("rmse", "paper")]
    assert [row["cases"] for row in means] == ["2", "2"]
    assert all("hindsight" in row["remarks"] for row in means)
    assert float(means[0]["mean"]) == pytest.approx(sum(rmse[:2]) / 2.0)


# Two recorded runs --------------------------------------------------------------------------------


def with_production(cycles: int, cycle: int, **fields: tuple[float, ...]) -> Iterator[Delivery]:
    """A run by hand with another production in one cycle."""
    for port, message in whole_run(cycles):
        if isinstance(message, Production) and message.cycle == cycle:
            message = msgspec.structs.replace(message, **fields)  # noqa: PLW2901
        yield port, message


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A recording in which `c2/c` delivers 55 instead of 60 kW in cycle 7."""
    folder = tmp_path / "first"
    folder.mkdir()
    less = with_production(20, 7, inverter_power_kw=(40.0, 80.0, 55.0, 59.0))
    write_run(folder / "run.mcap", less)
    return folder


POWER = ("production, power", "c2/c", 7, "12:00:07", 55.0, 60.0)
SKY = ("production, maximum", "c1/b", 3, "12:00:03", 90.0, 95.0)


@pytest.mark.parametrize(
    ("deliveries", "left_out", "differences", "cycles", "less_kw", "said"),
    [
        (whole_run(20), range(0), [POWER], 20, 5.0, "A: "),
        (
            with_production(20, 3, inverter_mpp_kw=(40.0, 95.0, 75.0, 75.0)),
            *(range(0), [SKY, POWER], 20, 5.0, "Sky or dispatch differ"),
        ),
        # In the cycles that both have recorded they are the same.
        (whole_run(6), range(0), [], 6, 0.0, "6 of 20 cycles are compared"),
        (whole_run(20), range(5, 9), [], 16, 0.0, "16 of 20 cycles are compared"),
    ],
    ids=["another command", "another sky", "shorter", "with a gap"],
)
def test_two_runs_stand_side_by_side_with_their_differences(
    run: Path,
    tmp_path: Path,
    deliveries: Iterable[Delivery],
    left_out: range,
    differences: list[tuple[object, ...]],
    cycles: int,
    less_kw: float,
    said: str,
) -> None:
    document, page, other = (tmp_path / name for name in ("x.json", "x.html", "other.mcap"))
    write_run(other, deliveries, is_kept=lambda pair: pair[1].cycle not in left_out)
    text = " ".join(done("compare", run, other, "--json", document, "--report", page).split())
    assert said in text
    assert ("bit for bit" in text) == (not differences)
    found = json.loads(document.read_bytes())
    columns = ("message", "node", "cycle", "time", "A", "B")
    rows = [tuple(row[name] for name in columns) for row in found["differences"]]
    assert rows == differences
    delivered = {row["figure"]: row for row in found["figures"]}["Delivered energy"]
    assert delivered["B"] == pytest.approx(239.0 * cycles / 3600.0)
    assert delivered["difference"] == pytest.approx(less_kw / 3600.0)
    html = page.read_text(encoding="utf-8")
    assert "delivered, A" in html
    assert "delivered, B" in html


def test_what_are_no_two_runs_of_one_plant_is_refused(run: Path, tmp_path: Path) -> None:
    renamed = tuple((f"{path}2", rating_kw) for path, rating_kw in PLAN.inverters)
    later_ns = PLAN.timing.start_time_ns + 10**9
    plans = {
        "later": with_changes(PLAN, start_time_ns=later_ns),
        "renamed": msgspec.structs.replace(PLAN, inverters=renamed),
    }
    for name, plan in plans.items():
        of_plant = [(port, message) for port, message in whole_run(20) if not port.node]
        write_run(tmp_path / name, of_plant, plan=plan)
        line = refusal("compare", run, tmp_path / name)
        assert line.startswith(f"heliarch: {tmp_path / name}: expected ")
        assert str(run) in line
    write_run(tmp_path / "empty", [], plan=plan_of(start_time_ns=PLAN.timing.start_time_ns))
    assert "cycle" in refusal("compare", run, tmp_path / "empty")
