"""`heliarch clusters`: its table, its JSON, and what it refuses."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from command_line import done, refusal

QUICK = ("clusters", "oahu", "--set", "time.cycle_s=10", "--random", "3")


@dataclass(frozen=True)
class Found:
    """The output of one run of the command: rows of the table by their first cell, JSON, page."""

    rows: dict[str, list[str]]
    text: str
    document: dict[str, Any]
    page: str


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Found:
    path = tmp_path_factory.mktemp("clusters") / "clusters.json"
    page = path.with_name("clusters.html")
    text = done(*QUICK, "--periods", "10,50,600", "--json", path, "--report", page)
    rows: dict[str, list[str]] = {}
    for line in text.splitlines():
        # A table that is too wide goes on below, with the names of its rows once more.
        match = re.match(r"(\S.*?) {2,}(\d[\d. -]*)$", line)
        if match:
            rows.setdefault(match[1], []).extend(match[2].split())
    documents = path.read_text(encoding="utf-8"), page.read_text(encoding="utf-8")
    return Found(rows, text, json.loads(documents[0]), documents[1])


def test_every_way_to_choose_clusters_has_its_row(found: Found) -> None:
    ways = ["virtual", "geographic", "random, mean of 3", "- least", "- most", "most alike"]
    orders = ["least alike first", "as listed", "most alike first"]
    assert list(found.rows) == ways + orders
    # Two correlations, two shares, three periods and what of the last began with the plant lacking.
    assert [len(row) for row in found.rows.values()] == [8] * 6 + [3] * 3
    assert "Search for virtual clusters: " in found.text
    assert "Order of help in the virtual clusters" in found.text
    lines = [line for line in found.text.splitlines() if not line.startswith("report: ")]
    assert max(map(len, lines)) <= 80
    assert 'id="shortfall-plot"' in found.page
    assert all(f">{cell}</td>" in found.page for row in found.rows.values() for cell in row)


def test_json_holds_every_seed_and_period(found: Found) -> None:
    document = found.document
    random = [("random", 1), ("random", 2), ("random", 3)]
    listed = [("virtual", None), ("geographic", None), *random, ("most alike", None)]
    assert [(way["clusters"], way["seed"]) for way in document["ways"]] == listed
    assert len({str(way["members"]) for way in document["ways"]}) == len(document["ways"])
    for row in (*document["ways"], *document["orders"]):
        assert len({name for cluster in row["members"] for name in cluster}) == 17
        assert [entry["central_period_s"] for entry in row["shortfalls"]] == [10.0, 50.0, 600.0]
    past = [way["past_correlation"] for way in document["ways"] if way["clusters"] == "random"]
    assert float(found.rows["random, mean of 3"][0]) == pytest.approx(sum(past) / 3, abs=6e-4)


def test_without_periods_those_of_the_paper_are_taken_that_the_cycle_allows() -> None:
    document = json.loads(done(*QUICK, "--random", "1", "--json", "-"))
    periods = [entry["central_period_s"] for entry in document["ways"][0]["shortfalls"]]
    assert periods == [10.0, 60.0]
    assert "--periods" in refusal(*QUICK, "--periods", "15")


def test_under_the_measured_sky_of_melpitz_virtual_neighbours_spare_the_central_controller(
    data_folder: Path,
) -> None:
    folder = data_folder / "hope-melpitz-1s"
    words = ("clusters", "hope-melpitz", "--data", str(folder), "--scheme", "paper")
    document = json.loads(done(*words, "--random", "1", "--json", "-"))
    virtual, geographic, *_ = document["ways"]
    # As docs/clusters.md has it.
    assert virtual["central_percent"] == pytest.approx(58.2, abs=0.05)
    assert geographic["central_percent"] == pytest.approx(71.7, abs=0.05)
    assert virtual["central_percent_if_plant_sufficient"] == pytest.approx(8.5, abs=0.05)
    assert geographic["central_percent_if_plant_sufficient"] == pytest.approx(38.0, abs=0.05)
