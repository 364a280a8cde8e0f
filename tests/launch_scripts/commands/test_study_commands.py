"""`heliarch clusters` and `heliarch delays`: tables, JSON and page agree."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from command_line import done, refusal

QUICK = ("clusters", "oahu", "--set", "time.cycle_s=10", "--random")


def test_table_json_and_page_have_every_way_to_choose_clusters(tmp_path: Path) -> None:
    path, page = tmp_path / "clusters.json", tmp_path / "clusters.html"
    text = done(*QUICK, "3", "--periods", "10,50,600", "--json", path, "--report", page)
    rows: dict[str, list[str]] = {}
    for line in text.splitlines():
        # A table that is too wide goes on below, with the names of its rows once more.
        match = re.match(r"(\S.*?) {2,}(\d[\d. -]*)$", line)
        if match:
            rows.setdefault(match[1], []).extend(match[2].split())
    ways = ["virtual", "geographic", "random, mean of 3", "- least", "- most", "most alike"]
    assert list(rows) == [*ways, "least alike first", "as listed", "most alike first"]
    # Two correlations, two shares, three periods and what of the last began with the plant lacking.
    assert [len(row) for row in rows.values()] == [8] * 6 + [3] * 3
    html = page.read_text(encoding="utf-8")
    assert 'id="shortfall-plot"' in html
    assert all(f">{cell}</td>" in html for row in rows.values() for cell in row)

    document = json.loads(path.read_bytes())
    random = [("random", 1), ("random", 2), ("random", 3)]
    listed = [("virtual", None), ("geographic", None), *random, ("most alike", None)]
    assert [(way["clusters"], way["seed"]) for way in document["ways"]] == listed
    assert len({str(way["members"]) for way in document["ways"]}) == len(document["ways"])
    for row in (*document["ways"], *document["orders"]):
        assert len({name for cluster in row["members"] for name in cluster}) == 17
        assert [entry["central_period_s"] for entry in row["shortfalls"]] == [10.0, 50.0, 600.0]
    past = [way["past_correlation"] for way in document["ways"] if way["clusters"] == "random"]
    assert float(rows["random, mean of 3"][0]) == pytest.approx(sum(past) / 3, abs=6e-4)


def test_without_periods_those_of_the_paper_are_taken_that_the_cycle_allows() -> None:
    document = json.loads(done(*QUICK, "1", "--json", "-"))
    periods = [entry["central_period_s"] for entry in document["ways"][0]["shortfalls"]]
    assert periods == [10.0, 60.0]
    assert "--periods" in refusal(*QUICK, "1", "--periods", "15")


def test_under_the_measured_sky_of_melpitz_virtual_neighbours_spare_the_central_controller(
    data_folder: Path,
) -> None:
    folder = data_folder / "hope-melpitz-1s"
    words = ("clusters", "hope-melpitz", "--data", str(folder), "--scheme", "paper")
    document = json.loads(done(*words, "--random", "1", "--json", "-"))
    names = ("central_percent", "central_percent_if_plant_sufficient")
    found = [[way[name] for name in names] for way in document["ways"][:2]]
    # As docs/clusters.md has it: virtual, then geographic.
    assert found == [pytest.approx([58.2, 8.5], abs=0.05), pytest.approx([71.7, 38.0], abs=0.05)]


def test_tables_json_and_page_have_every_run_with_delays(plant: str, tmp_path: Path) -> None:
    document, page = tmp_path / "delays.json", tmp_path / "delays.html"
    words = ("--duration", "124", "--workers", "2", "--json", document, "--report", page)
    text = done("delays", plant, *words)
    found = json.loads(document.read_bytes())
    outcomes = found["outcomes"]
    # 4 s count: of the central periods they hold two of 1 and two of 2 s.
    assert len(outcomes) == 2 * (9 + 7 + 2)
    assert {one["scheme"] for one in outcomes} == {"paper", "predictive"}
    assert "124 cycles" in found["title"]
    html = page.read_text(encoding="utf-8")
    for one in outcomes:
        mileage = f"{one['figures']['mileage']:,.0f}"
        assert mileage in text
        assert mileage in html
    assert 'id="study-plot"' in html
