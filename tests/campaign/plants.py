"""The plants of the campaign: ramps, delays, cycles of 0.1 to 10 s, periods, orders, offers, droop.

Each is small, so that a seed costs a second, and different in what the one before does not have.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

from judges import Worth

from scenarios.preparation import Preparation, RunOptions, prepare
from scenarios.scenario import load_scenario
from scenarios.settings import with_settings


@dataclass(frozen=True)
class CampaignPlant:
    """A plant, and what a run of it without faults is worth at least.

    worst: Bounds of `Worth`: measured, and a fifth more.
    settles_s: Time after the last fault in which it settles, besides `hold_cycles`.
    is_whole: Whether a run goes on to its end, after all has settled.
    """

    scenario: str
    duration: str
    settings: Mapping[str, Any]
    worst: Worth
    settles_s: float = 30.0
    is_whole: bool = False


_EIGHT: Final = str(Path(__file__).with_name("eight.toml"))

PLANTS: Final[dict[str, CampaignPlant]] = {
    "oahu": CampaignPlant(
        "oahu", "150s", {"commitment.share": 0.65}, Worth(0.0005, 0.0005, 0.0006, 0.0, 0.97)
    ),
    "paper": CampaignPlant(
        _EIGHT,
        "150s",
        {
            "control.scheme": "paper",
            "control.alpha_min": 0.4,
            "plant.actuator": "fraction",
            "plant.meter_noise": 0.01,
            "plant.available_bias": 0.0,
            "plant.available_share": 0.5,
            # Some inverters cannot go below `alpha_min` of their maximum, others make up for it.
            "orders": [{"at": 90, "power_kw": 1200}, {"at": 120, "schedule": True}],
        },
        Worth(0.0065, 0.0045, 0.005, 0.0, 0.68),
    ),
    "fast": CampaignPlant(
        _EIGHT,
        "50s",
        {
            "time.cycle_s": 0.1,
            "plant.ramp_percent_per_s": 20,
            "plant.delay_s": 0.25,
            "plant.revert": {"after_s": 5, "to": 0.3},
            "restart.frozen_s": 1.0,
            "irradiance.clouds.drift_speed_ms": 30,
            "commitment.share": 0.8,
        },
        Worth(0.0005, 0.0005, 0.0005, 0.0, 0.75),
    ),
    "day": CampaignPlant(
        _EIGHT,
        "2h",
        {
            "time.cycle_s": 10,
            "commitment": {"kind": "offered", "interval_s": 300, "lead_s": 60},
            "plant.revert": {"after_s": 120, "to": "release"},
            "plant.available_bias": 0.02,
        },
        Worth(0.0005, 0.0005, 0.0005, 0.9, 0.5),
        settles_s=300.0,
        is_whole=True,
    ),
    "periods": CampaignPlant(
        _EIGHT,
        "160s",
        {
            "control.period_cycles": [6, 2],
            "plant.meter_noise": 0.005,
            "commitment.share": 0.3,
            "grid.meter_error_percent": 3,
            "restart": {"most": 2, "within_s": 15, "backoff_s": 3},
        },
        Worth(0.032, 0.0005, 0.0085, 0.0, 0.4),
        settles_s=40.0,
    ),
    "orders": CampaignPlant(
        _EIGHT,
        "180s",
        {
            "plant.settings": [
                {"nodes": "c1/*", "ramp_percent_per_s": 10, "delay_s": 2},
                {"nodes": "c2/*", "ramp_percent_per_s": 25, "delay_s": 0.5},
                {"nodes": "c3/*", "revert": {"after_s": 20, "to": 0.2}},
            ],
            "plant.delay_s": 1,
            "plant.ramp_percent_per_s": 15,
            "orders": [
                {"at": 8, "power_kw": 1800},
                {"at": 14, "power_kw": 800, "ramp_kw_per_min": 4000},
                {"at": 35, "power_kw": 1500, "hold_s": 12, "ramp_kw_per_min": 6000},
                {"at": 70, "power_kw": 600},
                {"at": 85, "schedule": True, "ramp_kw_per_min": 2500},
                {"at": 150, "power_kw": 900},
            ],
        },
        Worth(0.019, 0.03, 0.0175, 0.0, 0.54),
        settles_s=80.0,  # While an order's ramp goes on, an error below it cannot be told.
    ),
    "droop": CampaignPlant(
        _EIGHT,
        "150s",
        {
            "control.correction": False,
            "control.offset": 0.01,
            "plant.available_bias": 0.04,
            "grid": {
                "ramp_up_kw_per_min": 1500,
                "ramp_down_kw_per_min": 3000,
                "loss_constant_percent": 0.3,
                "loss_quadratic_percent": 1.5,
                "meter_error_percent": 0.5,
                "pmax": 0.6,
                "pmin": 0.05,
                "droop": {"reserve_percent": 5, "fdbd1": -0.001, "ddn": 25},
            },
            "frequency": {
                "kind": "events",
                "events": [
                    {"at": 5, "depth_hz": -0.3, "duration_s": 25},
                    {"at": 60, "depth_hz": 0.25, "duration_s": 20},
                    {"at": 110, "depth_hz": -0.2, "duration_s": 15},
                ],
            },
            "orders": [{"at": 20, "power_kw": 2600}, {"at": 90, "schedule": True}],
        },
        Worth(0.0195, 0.0005, 0.0105, 0.0, 0.82),
    ),
    "losses": CampaignPlant(
        _EIGHT,
        "150s",
        {
            "grid": {
                "loss_constant_percent": 0.5,
                "loss_quadratic_percent": 4,
                "meter_error_percent": -2,
            },
            "commitment.share": 0.15,
            "regulation": {"kind": "synthetic", "capacity_kw": 1500, "seed": 3},
            "plant.ramp_percent_per_s": 30,
            "plant.meter_noise": 0.01,
        },
        Worth(0.0005, 0.024, 0.005, 0.0, 0.33),
    ),
    "storage": CampaignPlant(
        _EIGHT,
        "150s",
        {
            "control.correction": False,
            "commitment.share": 0.85,
            "storage": [
                {
                    "name": "near",
                    "cluster": "c1",
                    "rating_kw": 400,
                    "capacity_kwh": 3,
                    "state": 0.5,
                },
                {
                    "name": "far",
                    "rating_kw": 700,
                    "capacity_kwh": 9,
                    "ramp_percent_per_s": 10,
                    "standing_loss_kw": 20,
                },
            ],
        },
        Worth(0.0007, 0.0021, 0.0037, 0.0, 1.1),
    ),
    "fleet": CampaignPlant(
        str(Path(__file__).with_name("fleet.toml")),
        "150s",
        {},
        Worth(0.0027, 0.0005, 0.0018, 0.0, 0.92),
    ),
    "valley": CampaignPlant(
        "valley", "150s", {"commitment.share": 0.7}, Worth(0.0011, 0.0006, 0.0008, 0.0, 0.92)
    ),
}


@cache
def prepared(name: str) -> Preparation:
    plant = PLANTS[name]
    scenario = with_settings(load_scenario(plant.scenario), list(plant.settings.items()))
    return prepare(scenario, RunOptions(duration=plant.duration), "campaign")
