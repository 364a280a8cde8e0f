"""Clouds over the map: those under which the run was recorded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import done
from recordings_by_hand import whole_run, write_run

from bus_schemas.errors import InputError
from live_page.sky import clouds
from recordings.read.reader import RunReader
from recordings.read.series import series_of


def test_the_clouds_are_where_inverters_lack_sun(tmp_path: Path) -> None:
    done("simulate", "oahu", "--from", "12:26", "--duration", "20", "--out", tmp_path / "run")
    with RunReader(tmp_path / "run" / "run.mcap") as run:
        found, tree = clouds(run, 10), run.plan.tree
        ratings = np.array([tree.rating_kw(leaf) for leaf in tree.leaves])
        sunny = series_of(run).mpp_kw[10] / ratings
    lost = np.reshape(found["values"], (found["rows"], found["columns"]))
    east, north = np.array(run.plan.site.positions_m).T
    columns = ((east - found["west_m"]) / found["cell_m"]).astype(int)
    rows = ((found["north_m"] - north) / found["cell_m"]).astype(int)
    assert np.corrcoef(100 - lost[rows, columns], sunny)[0, 1] > 0.95


def test_a_run_whose_sky_is_not_synthetic_has_none(tmp_path: Path) -> None:
    write_run(tmp_path / "run.mcap", whole_run(5))
    with RunReader(tmp_path / "run.mcap") as run, pytest.raises(InputError, match="clouds"):
        clouds(run, 0)
