"""The plants of a fleet: what each takes from its scenario, and every wrong one is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from own_scenarios import Folder

from scenarios.scenario import load_scenario
from sim_plant.meters import Meters

SECOND = 'name = "north"\nscenario = "oahu"'
PLANTS = f"""
[[plants]]
name = "west"
scenario = "oahu"
lat = 21.3
lon = -158.0

[[plants]]
{SECOND}

[plants.set]
"plant.delay_s" = 2.0
"""


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    shipped = load_scenario("fleet").text.partition("# Each plant is")[0]
    return Folder(tmp_path, shipped.replace("duration_s = 3600", "duration_s = 5") + PLANTS)


def test_each_plant_keeps_its_clusters_and_has_its_own_sky_place_and_settings(
    folder: Folder,
) -> None:
    alone = load_scenario("oahu")
    fleet = folder.prepare()
    assert fleet.plan.tree.children("") == ("west", "north")
    first, second = fleet.profile.mpp_kw[:, :17], fleet.profile.mpp_kw[:, 17:]
    assert not np.array_equal(first, second)
    east_m, north_m = np.array(fleet.plan.site.positions_m).T
    assert np.hypot(east_m[0] - east_m[17], north_m[0] - north_m[17]) > 5_000.0
    delays_s = [fleet.plan.site.settings_of(leaf).delay_s for leaf in fleet.plan.tree.leaves]
    assert delays_s == [0.0] * 17 + [2.0] * 17
    folder.write("scenario.toml", alone.text.replace("duration_s = 3600", "duration_s = 5"))
    tree = folder.prepare().plan.tree
    assert [f"west/{leaf}" for leaf in tree.leaves] == list(fleet.plan.tree.leaves[:17])


def test_a_seed_changes_the_sky_of_each_plant_and_leaves_the_clusters(folder: Folder) -> None:
    first, second = folder.prepare(seed=1), folder.prepare(seed=2)
    assert first.plan.tree == second.plan.tree
    for plant in (slice(0, 17), slice(17, 34)):
        assert not np.array_equal(first.profile.mpp_kw[:, plant], second.profile.mpp_kw[:, plant])


def test_plants_under_different_skies_on_one_spot_are_warned_of(folder: Folder) -> None:
    assert not [one for one in folder.prepare().remarks if "on one spot" in one]
    folder.change("lat = 21.3\nlon = -158.0", "seed = 5")
    (warning,) = [one for one in folder.prepare().remarks if "on one spot" in one]
    assert "got west, north on one spot" in warning
    folder.change(SECOND, f"{SECOND}\nseed = 5")
    assert not [one for one in folder.prepare().remarks if "on one spot" in one], "one sky"


def test_the_rating_of_a_fleet_is_what_its_plants_may_feed_in(folder: Folder) -> None:
    folder.change(SECOND, f"{SECOND}\nexport_limit_kw = 5000")
    tree = folder.prepare().plan.tree
    assert tree.rating_kw("north") == 5000.0
    assert tree.rating_kw("") == 13_000.0
    shares = [tree.sharing_kw(leaf) for leaf in tree.leaves]
    assert sum(shares[17:]) == pytest.approx(5000.0)


def test_a_fleet_promises_no_more_than_its_plants_may_feed_in(folder: Folder) -> None:
    free_kw = folder.prepare().profile.commitment_kw
    folder.change(SECOND, f"{SECOND}\nexport_limit_kw = 2000")
    profile = folder.prepare().profile
    share, plant_kw = 0.65, free_kw / 0.65 / 2  # Both stand under nearly the same clear sky.
    np.testing.assert_allclose(profile.commitment_kw, share * (plant_kw + 2000.0), rtol=0.01)


def test_a_plant_without_clusters_is_a_column_of_itself(folder: Folder) -> None:
    meters = Meters(folder.prepare().plan, ("west", "north/c1", "north/c2", "north/c3"))
    power_kw = np.array([[400.0, 100.0, 200.0, 300.0]])
    assert meters.plant_kw("west", power_kw) == pytest.approx(400.0)
    assert meters.fed_in_kw(power_kw) == pytest.approx(1000.0)


def test_a_plant_may_have_a_time_zone_of_its_own(folder: Folder) -> None:
    before = folder.prepare()
    folder.change('"plant.delay_s" = 2.0', '"time.timezone" = "America/Anchorage"')
    after = folder.prepare()
    np.testing.assert_array_equal(after.profile.mpp_kw, before.profile.mpp_kw)
    assert after.plan.control.neighbourhoods == before.plan.control.neighbourhoods


def test_the_controllers_of_a_plant_go_to_another_host_together(folder: Folder) -> None:
    secure = {"secure": True, "address": "10.0.0.1", "on": ("10.0.0.2=north/*",)}
    plan = folder.prepare(**secure).plan
    away = {agent for agent in plan.agents if agent.split("/")[0] == "north"}
    assert plan.access.addresses == dict.fromkeys(away, "10.0.0.2")


DELAY, SEED = '"plant.delay_s" = 2.0', '"irradiance.seed" = 2'
MEASURED = """\
name = "hope"
scenario = "hope-melpitz"
seed = 4"""


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('name = "north"\n', "", "plants[1].name: expected"),
        ('name = "north"', 'name = "a/b"', "plants[1].name: expected"),
        ('name = "north"', 'name = "plant"', "plants[1].name: expected a name other"),
        ('name = "north"', 'name = "west"', "plants[1].name: expected another name"),
        (SECOND, 'name = "north"', "plants[1].scenario: expected"),
        (SECOND, 'name = "north"\nscenario = "oahuu"', "plants[1].scenario: "),
        (SECOND, 'name = "north"\nscenario = "fleet"', "plants[1].scenario: expected plants"),
        (SECOND, 'name = "north"\nscenario = "none.toml"', "plants[1].scenario: none.toml"),
        (SECOND, f"{SECOND}\nlat = 21.0", "plants[1].lat: expected lon"),
        (SECOND, f"{SECOND}\nlat = 91.0\nlon = 0.0", "plants[1].lat: expected"),
        (SECOND, f"{SECOND}\nlat = 21.0\nlon = nan", "plants[1].lon: expected"),
        (SECOND, f"{SECOND}\nseed = -1", "plants[1].seed: expected"),
        (SECOND, f"{SECOND}\nexport_limit_kw = 0", "plants[1].export_limit_kw: expected"),
        (SECOND, f"{SECOND}\nexport_limit_mw = 5", "plants[1].export_limit_mw: "),
        (SECOND, MEASURED, "plants[1].seed: expected none with measured data"),
        ('"plant.delay_s" = 2.0', '"plant.delays" = 2', "plants[1].set: plant.delays: "),
        ('"plant.delay_s" = 2.0', '"plant.delay_s" = -2', "plants[1].set: plant.delay_s: "),
        ('"plant.delay_s" = 2.0', '"grid.pmin" = 0.1', "plants[1].scenario: expected grid.pmin"),
        ('"plant.delay_s" = 2.0', '"plant.inverters" = "no.csv"', "plants[1].scenario: no.csv"),
        *(
            (DELAY, f'"{field}" = 1', f"got {field} for north")
            for field in ("commitment.share", "time.cycle_s", "control.scheme", "plant.actuator")
        ),
        (f"\n[plants.set]\n{DELAY}", f"seed = 1\n[plants.set]\n{SEED}", "seed too for north"),
        ("[commitment]", "[plant]\nrating_kw = 10\n\n[commitment]", "plant.rating_kw: expected"),
        ("[commitment]", "[pv]\ntilt_deg = 1\n\n[commitment]", "pv: expected none in a fleet"),
        (PLANTS, "[[plants]]\n", "plants[0].name: expected"),
        (PLANTS, "", "plant: expected table"),
    ],
)
def test_a_wrong_plant_is_refused_in_one_line(
    folder: Folder, old: str, new: str, complaint: str
) -> None:
    folder.change(old, new)
    found = folder.complaint()
    assert complaint in found, found
    assert "\n" not in found


WIND = """\
name = "wind"
title = "Two turbines of 2 MW, by their measured power"

[time]
start = 2010-04-01T12:00:00
timezone = "Pacific/Honolulu"
duration_s = 5

[plant]
rating_kw = 4000

[irradiance]
kind = "dc-current"
currents = "power.csv"
positions = "turbines.csv"
full_power_current = 2000

[commitment]
kind = "constant"
power_kw = 2000

[control]
cluster_sizes = [[1, 1]]
clusters = "listed"

[neighbours]
history = "hindsight"
"""


def test_a_plant_of_a_fleet_can_be_of_wind_turbines_by_their_measured_power(folder: Folder) -> None:
    powers_kw = [[900.0, 1500.0], [1000.0, 1400.0], [1200.0, 300.0], [800.0, 0.0], [700.0, 2000.0]]
    rows = [f"{second},{one},{two}" for second, (one, two) in enumerate(powers_kw)]
    folder.write("power.csv", "\n".join(["t_s,a,b", *rows, "5,700,2000"]) + "\n")
    folder.write("turbines.csv", "combiner,inverter,x_m,y_m\na,t1,0,0\nb,t2,600,0\n")
    folder.write("wind.toml", WIND)
    folder.change('kind = "share-of-clear-sky"\nshare = 0.65', 'kind = "constant"\npower_kw = 3000')
    folder.change(SECOND, 'name = "north"\nscenario = "wind.toml"')
    found = folder.prepare()
    assert found.plan.tree.leaves[17:] == ("north/c1/invt1", "north/c2/invt2")
    np.testing.assert_allclose(found.profile.mpp_kw[:, 17:], powers_kw)
