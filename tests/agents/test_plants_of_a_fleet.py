"""Plants of a fleet at their own meters: export limits, and a plant that is cut off."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import command_line
import numpy as np
import pytest

from bus_schemas.messages import Dispatch, Message, Meter
from bus_schemas.signals import DISPATCH, METER
from heliarch import open_run
from recordings.inspect.agent_states import states_of
from recordings.read.reader import RunReader
from recordings.read.series import plant_series_of
from results.figures import run_figures
from results.report.run_report import run_line
from results.two_runs import with_and_without_help

RATINGS_KW = {"west": 8000.0, "north": 5500.0, "east": 8000.0}


def simulated(folder: Path, *words: str) -> Path:
    command = ("simulate", "fleet", "--from", "12:29", "--duration", "60", *words)
    result = command_line.heliarch(*command, "--out", folder)
    assert result.exit_code == 0, result.output
    return folder


def read_kw(run: RunReader) -> dict[str, np.ndarray]:
    """Return what each meter read, and the dispatch, cycle by cycle."""
    found: dict[str, list[float]] = {}
    message: Message
    for port, message in run.messages(METER, DISPATCH):
        assert isinstance(message, Meter | Dispatch)
        found.setdefault(str(port), []).append(message.power_kw)
    return {port: np.array(powers_kw) for port, powers_kw in found.items()}


def test_a_plant_keeps_its_export_limit_while_its_inverters_could_give_more(tmp_path: Path) -> None:
    # The sky over `north` gives more than its limit throughout; the fleet lacks power.
    folder = simulated(tmp_path / "run", "--set", "commitment.share=0.95")
    with RunReader(folder) as run:
        read, figures = read_kw(run), run_figures(plant_series_of(run))
    document: Any = with_and_without_help(folder).document
    rows = {row["figure"]: row for row in document}
    alone = rows["Shortfall, control-caused"]["without help"]
    assert alone == pytest.approx(figures["without-help-energy"])
    assert rows["Available energy"]["difference"] == pytest.approx(0.0, abs=1e-6)
    north_kw = read["north/meter"][10:]
    assert np.median(north_kw) == pytest.approx(RATINGS_KW["north"], rel=0.005)
    assert north_kw.max() < RATINGS_KW["north"] * 1.02
    total_kw = sum(read[f"{plant}/meter"] for plant in RATINGS_KW)
    np.testing.assert_allclose(read["meter"], total_kw)


def test_a_plant_that_is_cut_off_serves_its_own_share_and_is_named(tmp_path: Path) -> None:
    cut = ("--fault", "partition=west|central,at=15s..45s", "--set", "commitment.share=0.3")
    with RunReader(simulated(tmp_path / "run", *cut)) as run:
        read, spans = read_kw(run), states_of(run).spans()
    share_kw = read["dispatch"] * (RATINGS_KW["west"] / sum(RATINGS_KW.values()))
    alone = slice(30, 44)  # Once its setpoint has expired.
    np.testing.assert_allclose(read["west/meter"][alone], share_kw[alone], rtol=0.01)
    np.testing.assert_allclose(read["meter"][alone], read["dispatch"][alone], rtol=0.01)
    assert [(one.agent, one.kind, one.first_cycle) for one in spans] == [("west", "cut off", 15)]


RAMPED = """\
name = "ramped"
title = "Two plants under a clear sky, one of which may only rise slowly"

[time]
start = 2010-04-01T12:00:00
timezone = "Pacific/Honolulu"
duration_s = 60

[commitment]
kind = "constant"
power_kw = 4000

[[plants]]
name = "slow"
scenario = "oahu"

[plants.set]
"irradiance.clouds.cloud_cover" = 0.0
"grid.ramp_up_kw_per_min" = 3000.0

[[plants]]
name = "quick"
scenario = "oahu"

[plants.set]
"irradiance.clouds.cloud_cover" = 0.0

[[orders]]
at = 20
power_kw = 7000
"""


def test_a_plant_keeps_its_ramp_limit_at_its_own_meter(tmp_path: Path) -> None:
    (tmp_path / "ramped.toml").write_text(RAMPED, encoding="utf-8")
    folder = tmp_path / "run"
    result = command_line.heliarch("simulate", str(tmp_path / "ramped.toml"), "--out", folder)
    assert result.exit_code == 0, result.output
    with RunReader(folder) as run:
        read = read_kw(run)
    steps_kw = {plant: np.diff(read[f"{plant}/meter"][15:]) for plant in ("slow", "quick")}
    assert steps_kw["quick"].max() > 1000.0
    assert steps_kw["slow"].max() < 3000.0 / 60.0 * 1.1
    assert read["slow/meter"][-1] > 3400.0


def test_a_night_is_warned_of_once_and_has_no_hard_minute(tmp_path: Path) -> None:
    out = tmp_path / "run"
    night = ("--from", "23:00", "--duration", "5s", "--out", out)
    printed = command_line.done("simulate", "fleet", *night)
    assert printed.count("without any sun") == 1
    assert "west, north, east: warning" in printed
    assert "lacking" not in printed
    run = open_run(out)
    assert "seed" not in run_line(run.plan), "each plant has one of its own"
    plants = {one.name: one for one in run.summary.plants}
    assert plants["east"].highest_kw < 0.0, "it takes what is lost on its way"
    (row,) = (line.split() for line in printed.splitlines() if line.startswith("east "))
    assert (float(row[3]), float(row[6])) == pytest.approx(
        (plants["east"].delivered_kwh, plants["east"].highest_kw), abs=0.05
    )
    assert float(row[3]) < 0.0
