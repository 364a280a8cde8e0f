"""The plant simulator as a process of a run."""

from __future__ import annotations

from pathlib import Path

from agents.launcher_link import LauncherLink
from agents.plan import RunPlan
from agents.process import AgentProcess, run_guarded
from bus_schemas.tree import PLANT
from sim_plant.devices import Devices
from sim_plant.plant import Plant
from sim_plant.plant_run import ArmingError, PlantRun
from sim_plant.profile import Profile


def run_plant(
    plan: RunPlan, profile: Profile, link: LauncherLink, patience_s: float, folder: Path
) -> int:
    """Join the bus and lead the run in a folder. Returns the exit status."""

    def run() -> None:
        devices = Devices(plan, folder) if plan.devices else None
        with AgentProcess(plan, Plant(plan, profile, devices), link) as process:
            PlantRun(process, patience_s).run()

    return run_guarded(PLANT, link, run, expected=(ArmingError,))
