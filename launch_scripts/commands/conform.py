"""`heliarch conform`: test a device in the place of an agent against docs/wire.md."""

from __future__ import annotations

from pathlib import Path

from agents.settings import Scheme
from bus_schemas.tree import PLANT
from launch_scripts.commands.boundary import FAILED, OK
from launch_scripts.commands.output import say, write_json
from launch_scripts.scenarios.run_options import RunOptions
from studies.tables import console_for, json_rows, print_table


def conform(
    agent: str,
    *,
    scenario: str = "oahu",
    command: str | None = None,
    pace: str = "1",
    scheme: Scheme | None = "paper",
    seed: int | None = None,
    tolerance: float = 0.0,
    wait_s: float = 60.0,
    base_port: int | None = None,
    out: Path | None = None,
    json: str | None = None,
) -> int:
    """Test your own device against each requirement of the wire document.

    Plays the agents around the device: a normal run, inputs at their limits,
    wrong, random, late or missing inputs, random faults, links that close, a
    restart. Compares each answer with that of
    Heliarch's own agent. Exit status 1: a requirement is not met.

    AGENT: The agent that the device replaces: c2/inv07, c2, central or plant.
    --scenario SCENARIO: The plant around it, as for launch.
    --command COMMAND: Command that starts the device; {plan} becomes the path of the plan, {node}
        the agent. Without it, start the device yourself for each plan that is printed; restarts are
        then not tested.
    --pace PACE: Pace of the tests in real time; max leaves these out.
    --seed NUMBER: Seed of the clouds, of random inputs and of random faults.
    --tolerance X 0..: Largest difference between numbers that count as equal.
    --external-timeout SECONDS (wait_s): How long to wait for the device.
    --base-port PORT: Listen on this port and those after it, with the plant's name as namespace.
    --out DIR: Folder of the recorded tests; default runs/NAME-TIME.
    Example: heliarch conform c2/inv07 --command 'python examples/direct_controller.py --plan {plan}
        --node {node}'
    """
    from launch_scripts.launcher.run_folder import RunRequest, prepare_run
    from launch_scripts.scenarios.scenario import load_scenario
    from recordings.verify.comparison import Comparison
    from studies.conformance import conform as of_controller
    from studies.conformance import plant as of_plant
    from studies.conformance.device import Device

    console = console_for(json)
    scenario_file = load_scenario(scenario)
    cycles = of_plant.CYCLES if agent == PLANT else of_controller.CYCLES
    options = RunOptions(
        duration=f"{cycles * scenario_file.scenario.time.cycle_s:g}",
        pace=pace,
        seed=seed,
        scheme=scheme,
        external=[agent],
        external_timeout_s=wait_s,
        base_port=base_port,
        faults=[of_plant.FROZEN] if agent == PLANT else None,
    )
    preparation, folder = prepare_run(RunRequest(scenario_file, options, out))
    with Device(command, agent, folder.path) as device:
        if agent == PLANT:
            findings = of_plant.try_plant(preparation, folder, device, console)
        else:
            comparison = Comparison(tolerance)
            trials = of_controller.Conformance(
                preparation, folder, device, comparison, lambda line: say(console, line)
            )
            findings = trials.run(seed or 0)
    print_table(console, findings.table(agent))
    say(console, f"trials: {folder.path}")
    rows = json_rows(findings.table(agent))
    write_json({"agent": agent, "passed": findings.passed, "requirements": rows}, json)
    return OK if findings.passed else FAILED
