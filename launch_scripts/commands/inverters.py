"""`heliarch inverters`: a plant's simulated inverters as SunSpec devices."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from math import inf
from pathlib import Path
from typing import Final

import typer

from bus_schemas.errors import InputError
from launch_scripts.commands.options import changed_scenario
from launch_scripts.scenarios.run_options import RunOptions, TimeOptions

_PORT: Final = 5020


def inverters(
    scenario: str = "oahu",
    *,
    address: str = "127.0.0.1",
    port: int = _PORT,
    base_port: int | None = None,
    wait: bool = False,
    span: TimeOptions,
    seed: int | None = None,
    settings: list[str] | None = None,
    data: Path | None = None,
) -> None:
    """Serve a plant's simulated inverters over Modbus TCP, in real time.

    They are SunSpec inverters under the clouds of the scenario: another plant
    controller can read and limit them. The last unit is the meter at the
    plant's connection. Ends with the scenario, or with Ctrl-C.

    --address ADDRESS: Address at which to listen; 0.0.0.0 is for other hosts too.
    --port PORT 0..65535: One port, with a unit for each inverter.
    --base-port PORT 1..65535: Instead, a port for each inverter, from this port on; all are unit 1.
    --wait: Let the clouds stand still until the first limit is written.
    Example: heliarch inverters oahu --port 5020 --set plant.delay_s=1
    """
    if base_port is not None and port != _PORT:
        raise InputError("--port: expected no --base-port with it")
    from launch_scripts.launcher.run_folder import new_run_id
    from launch_scripts.scenarios.preparation import prepare
    from sunspec.limited_inverter import LimitedInverter
    from sunspec.server import Sky, served

    scenario_file = changed_scenario(scenario, data, settings)
    options = RunOptions(**vars(span), seed=seed)
    prepared = prepare(scenario_file, options, new_run_id(scenario_file.scenario.name))
    plan = prepared.plan
    sky = Sky(prepared.profile.mpp_kw, plan.cycle_ns / 1e9, None if wait else time.monotonic())

    follows = {name: plan.settings_of(name) for name, _ in plan.inverters}
    simulated = {
        name: LimitedInverter(
            rating_kw,
            sky.possible_kw(place),
            follows[name].delay_s or 0.0,
            follows[name].ramp_percent_per_s or inf,
        )
        for place, (name, rating_kw) in enumerate(plan.inverters)
    }
    first_port, a_port_each = base_port or port, base_port is not None
    serving = served(simulated, sky, time.monotonic, address, first_port, a_port_each=a_port_each)
    with suppress(KeyboardInterrupt), serving as addresses:
        for name, where in addresses.items():
            typer.echo(f"meter: {where}" if name == "meter" else f"--device {name}={where}")
        typer.echo(f"the sky begins at {prepared.local_start()}")
        sys.stdout.flush()
        while not sky.is_over(time.monotonic()):
            time.sleep(0.2)
