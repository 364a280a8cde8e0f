"""Settings change a scenario's tables field by field."""

from __future__ import annotations

from scenarios.scenario import load_scenario
from scenarios.settings import with_settings

GRID = {"lat": 21.3, "lon": -158.1, "rows": 3, "columns": 3, "apart_m": 100}


def test_a_table_removes_a_field_that_it_names_as_none() -> None:
    changed = with_settings(
        load_scenario("oahu"), [("plant", {"inverters": None, "grid": GRID, "rating_kw": 4500})]
    )
    plant = changed.scenario.plant
    assert (plant.inverters, plant.rating_kw, plant.altitude_m) == (None, 4500, 11)
    assert "inverters = " not in changed.text
