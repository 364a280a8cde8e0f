"""`heliarch conform`: test a device in the place of an agent against docs/wire.md."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from agents.settings import Scheme
from bus_schemas.errors import InputError
from bus_schemas.tree import PLANT
from heliarch.cli.boundary import FAILED, OK
from heliarch.cli.junit import Case, check_junit, write_junit
from heliarch.cli.options import FILES, Json, Junit, Scenario, Tolerance
from heliarch.cli.output import Output
from results.tables import json_rows
from scenarios.run_options import RunOptions, Whole


def conform(
    agent: str,
    /,
    *,
    scenario: Annotated[Scenario, Parameter("--scenario", metavar="SCENARIO")] = "oahu",
    command: Annotated[str | None, Parameter(metavar="COMMAND")] = None,
    pace: Annotated[str, Parameter(metavar="PACE")] = "1",
    scheme: Scheme | None = "paper",
    seed: Whole | None = None,
    tolerance: Tolerance = 0.0,
    wait_s: Annotated[float, Parameter("--external-timeout", metavar="SECONDS")] = 60.0,
    base_port: Annotated[Whole | None, Parameter(metavar="PORT")] = None,
    out: Annotated[Path | None, Parameter(metavar="DIR", group=FILES)] = None,
    json: Json = None,
    junit: Junit = None,
) -> int:
    """Test your own device against the wire document.

    Each requirement is one trial.

    Plays the agents around the device: a normal run, inputs at their limits, wrong, random, late or
    missing inputs, random faults, a restart. Compares each answer with that of Heliarch's own
    agent. Exit status 1: a requirement is not met.

    Example: `heliarch conform c2/inv07
    --command 'python examples/direct_controller.py --plan {plan} --node {node}'`

    Parameters
    ----------
    agent
        The controller that the device replaces: c2/inv07, c2 or central.
    scenario
        The plant around it, as for launch.
    command
        Command that starts the device; {plan} becomes the path of the plan, {node} the agent.
        Without it, start the device yourself for each plan that is printed; restarts are then not
        tested.
    pace
        Pace of the tests in real time; max leaves these out.
    scheme
        How maximum powers are estimated.
    seed
        Seed of the clouds, of random inputs and of random faults.
    wait_s
        How long to wait for the device.
    base_port
        Listen on this port and those after it, with the plant's name as namespace.
    out
        Folder of the recorded tests; default runs/NAME-TIME.
    """
    from launch_scripts.run_folder import prepare_run
    from recordings.verify.comparison import Equality
    from scenarios.scenario import load_scenario
    from studies.conformance.conform import CYCLES, Conformance
    from studies.conformance.device import Device

    check_junit(junit)
    if agent == PLANT:
        raise InputError.of("AGENT", "expected a controller such as c2/inv07, got plant")
    output, device, file = Output(json), Device(command, agent), load_scenario(scenario)
    options = RunOptions(
        duration=f"{CYCLES * file.scenario.time.cycle_s:g}",
        pace=pace,
        seed=seed,
        scheme=scheme,
        external=[agent],
        external_timeout_s=wait_s,
        base_port=base_port,
    )
    try:
        preparation, folder = prepare_run(file, options, out)
    except InputError as error:  # The user has not typed the option that says the same.
        raise (error.renamed("AGENT") if error.field == "--external" else error) from None
    with device:
        trials = Conformance(preparation, folder, device, Equality(tolerance), output.say)
        findings = trials.run(seed or 0)
    table = findings.table(agent)
    output.show(table)
    output.say(f"trials: {folder.path}")
    requirements, failures = json_rows(table), [one._asdict() for one in findings.failures]
    document = {"agent": agent, "passed": findings.passed, "requirements": requirements}
    output.write({**document, "failures": failures})
    write_junit(junit, {f"conform {agent}": _cases(requirements)})
    return OK if findings.passed else FAILED


def _cases(requirements: Iterable[dict[str, Any]]) -> Iterator[Case]:
    for row in requirements:
        name, result, text = row["requirement"], row["result"], row["text"]
        failed = result not in {"PASS", "not tried"}
        skipped = result if result == "not tried" else ""
        yield Case(name, f"{result}: {text}" if failed else "", skipped)
