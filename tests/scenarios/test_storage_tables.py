"""A storage in a scenario: where it stands, and every wrong one is refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from own_scenarios import Folder

from scenarios.scenario import load_scenario

STORAGE = """

[[storage]]
name = "battery"
rating_kw = 100
capacity_kwh = 50
"""


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    shipped = load_scenario("oahu-storage").text.partition("# Beside the inverters")[0]
    return Folder(tmp_path, shipped.replace("duration_s = 3600", "duration_s = 5") + STORAGE)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("rating_kw = 100\n", "", "storage[0].rating_kw: expected"),
        ("rating_kw = 100", "rating_kw = 0", "storage[0].rating_kw: expected"),
        ("rating_kw = 100", "rating_kw = -1", "storage[0].rating_kw: expected"),
        ("rating_kw = 100", "rating_kw = nan", "storage[0].rating_kw: expected"),
        ("rating_kw = 100", "rating_kw = 1e12", "storage[0].rating_kw: expected"),
        ("rating_kw = 100", "rating_kw = 'much'", "storage[0].rating_kw: expected"),
        ("rating_kw = 100", "rating = 100", "storage[0].rating: "),
        ("rating_kw = 100", "rating_kw = [100]", "storage[0].rating_kw: expected"),
        ("capacity_kwh = 50\n", "", "storage[0].capacity_kwh: expected"),
        ("capacity_kwh = 50", "capacity_kwh = 0", "storage[0].capacity_kwh: expected"),
        ("capacity_kwh = 50", "capacity_kwh = inf", "storage[0].capacity_kwh: expected"),
        ('name = "battery"\n', "", "storage[0].name: expected"),
        ('name = "battery"', 'name = ""', "storage[0].name: expected"),
        ('name = "battery"', 'name = "a/b"', "storage[0].name: expected"),
        ('name = "battery"', 'name = "central"', "storage[0].name: expected"),
        ('name = "battery"', 'name = "c1"', "storage[0].name: expected a name that no"),
        ('name = "battery"', 'name = "b"\ncluster = "c9"', "storage[0].cluster: expected"),
        ('name = "battery"', 'name = "b"\ncluster = "c1/inv01"', "storage[0].cluster: expected"),
        ('name = "battery"', 'name = "inv01"\ncluster = "c1"', "storage[0].name: expected a name"),
        ("capacity_kwh = 50", f"capacity_kwh = 50{STORAGE}", "storage[1].name: expected a name"),
        ("capacity_kwh = 50", "capacity_kwh = 50\nstate = 1.1", "storage[0].state: expected"),
        ("capacity_kwh = 50", "capacity_kwh = 50\nstate = 0.05", "storage[0].state: expected"),
        ("capacity_kwh = 50", "capacity_kwh = 50\ntarget = 0.05", "storage[0].target: expected"),
        ("capacity_kwh = 50", "capacity_kwh = 50\nstate = nan", "storage[0].state: expected"),
        (
            "capacity_kwh = 50",
            "capacity_kwh = 50\nlowest_state = 0.9\nhighest_state = 0.8",
            "storage[0].highest_state: expected",
        ),
        (
            "capacity_kwh = 50",
            "capacity_kwh = 50\ncharge_efficiency = 0",
            "storage[0].charge_efficiency: expected",
        ),
        (
            "capacity_kwh = 50",
            "capacity_kwh = 50\ndischarge_efficiency = 1.01",
            "storage[0].discharge_efficiency: expected",
        ),
        (
            "capacity_kwh = 50",
            "capacity_kwh = 50\nstanding_loss_kw = -1",
            "storage[0].standing_loss_kw: expected",
        ),
        ("capacity_kwh = 50", "capacity_kwh = 50\ndelay_s = -1", "storage[0].delay_s: expected"),
        (
            "capacity_kwh = 50",
            "capacity_kwh = 50\nramp_percent_per_s = 0",
            "storage[0].ramp_percent_per_s: expected",
        ),
        ("[control]", '[control]\nstorage = "middle"', "control.storage: expected"),
        ("[[storage]]", "[storage]", "storage: expected"),
    ],
)
def test_a_wrong_storage_is_refused_in_one_line(
    folder: Folder, old: str, new: str, complaint: str
) -> None:
    folder.change(old, new)
    found = folder.complaint()
    assert found.startswith(f"{folder.scenario}: ")
    assert f": {complaint}" in found
    assert "\n" not in found


@pytest.mark.parametrize(("cluster", "path"), [("", "battery"), ("c2", "c2/battery")])
def test_it_stands_at_the_bus_bar_of_the_plant_or_in_a_cluster(
    folder: Folder, cluster: str, path: str
) -> None:
    if cluster:
        folder.change('name = "battery"', f'name = "battery"\ncluster = "{cluster}"')
    tree = folder.prepare().plan.tree
    assert tree.storage_paths == (path,)
    assert tree.rating_kw("") == pytest.approx(8000.0), "its rating is not the plant's"
    assert path in tree.children(cluster)
