"""What the user asks of a run: from command-line values to a prepared run and its folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from agents.plan import Actuator, Scheme
from bus_schemas.errors import InputError
from launch_scripts.launcher.run_folder import RunFolder, new_run_id, run_folder
from launch_scripts.scenarios.externals import NO_EXTERNALS, ExternalOptions
from launch_scripts.scenarios.machine_table import AS_THE_SCENARIO_SAYS, MachineOptions
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import FASTEST_PACE, SLOWEST_PACE, ScenarioFile


@dataclass(frozen=True, slots=True)
class RunRequest:
    """The values of the command line; None where the user gave none."""

    driver: Literal["launch", "simulate"]
    scenario: ScenarioFile
    start: str | None = None
    end: str | None = None
    duration: str | None = None
    pace: str | None = None
    seed: int | None = None
    scheme: Scheme | None = None
    actuator: Actuator | None = None
    out: Path | None = None
    cycle_s: float | None = None
    faults: tuple[str, ...] = ()
    external: ExternalOptions = NO_EXTERNALS
    machine: MachineOptions = AS_THE_SCENARIO_SAYS


def prepare_run(request: RunRequest) -> tuple[Preparation, RunFolder]:
    """Work out the run and the path of its folder; write nothing yet.

    Raises
    ------
    InputError
        The options, the scenario and its data do not fit together.
    """
    run_id = new_run_id(request.scenario.scenario.name)
    folder = run_folder(run_id, request.out)
    options = RunOptions(
        request.start,
        request.duration,
        parse_pace(request.pace),
        request.seed,
        request.scheme,
        request.actuator,
        request.cycle_s,
        request.faults,
        request.external,
        request.machine,
        request.end,
    )
    preparation = prepare(request.scenario, options, run_id)
    _check_faults(request, preparation)
    return preparation, folder


def _check_faults(request: RunRequest, preparation: Preparation) -> None:
    plan = preparation.plan
    if request.driver == "launch" and plan.lockstep and plan.faults:
        where = f"--fault {request.faults[0]}" if request.faults else "faults of the scenario"
        raise InputError(
            f"{where}: expected a --pace such as 1 with it, got lockstep, where a lost message is "
            "waited for without end"
        )


def parse_pace(text: str | None) -> float | Literal["max"] | None:
    """Read the value of `--pace`."""
    if text is None or text == "max":
        return "max" if text else None
    try:
        pace = float(text)
    except ValueError:
        pace = 0.0
    if not SLOWEST_PACE <= pace <= FASTEST_PACE:
        raise InputError(
            f"--pace: expected {SLOWEST_PACE:g} to {FASTEST_PACE:g}, or max, got {text}"
        )
    return pace
