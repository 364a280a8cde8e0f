"""`heliarch inverters`: a plant's simulated inverters and storages as SunSpec devices."""

from __future__ import annotations

import time
from contextlib import suppress
from math import inf
from typing import Annotated

from cyclopts import Parameter

from heliarch.cli.options import Data, Port, Scenario, Settings, changed_scenario
from heliarch.cli.output import Output
from scenarios.elsewhere import read_address
from scenarios.run_options import RunOptions, Seed, TimeOptions
from sunspec.simulated import LimitedInverter, SetStorage


def inverters(
    scenario: Scenario = "oahu",
    /,
    *,
    address: Annotated[str, Parameter(metavar="ADDRESS")] = "127.0.0.1",
    port: Port = 5020,
    wait: bool = False,
    seed: Seed = None,
    settings: Settings = None,
    span: TimeOptions = TimeOptions(),
    data: Data = None,
) -> None:
    """Serve simulated inverters and storages over Modbus TCP.

    They are SunSpec devices under the clouds of the scenario: another plant controller can read
    and command them. The last unit is the meter at the plant's connection. Ends with the scenario,
    or with Ctrl-C.

    Example: `heliarch inverters oahu --port 5020 --set plant.delay_s=1`

    Parameters
    ----------
    address
        Address at which to listen; 0.0.0.0 is for other hosts too.
    port
        Port at which to listen, with a unit for each device.
    wait
        Let the clouds stand still until the first write.
    """
    read_address(address)
    from scenarios.preparation import prepare
    from sunspec.server import Sky, served

    options = RunOptions(**vars(span), seed=seed)
    prepared = prepare(changed_scenario(scenario, data, settings), options, "inverters")
    plan = prepared.plan
    sky = Sky(prepared.profile.mpp_kw, plan.timing.cycle_s, None if wait else time.monotonic())
    simulated: dict[str, LimitedInverter | SetStorage] = {}
    for place, (name, rating_kw) in enumerate(plan.inverters):
        follows = plan.site.settings_of(name)
        simulated[name] = LimitedInverter(
            rating_kw,
            sky.available_kw(place),
            follows.delay_s or 0.0,
            follows.ramp_percent_per_s or inf,
        )
    simulated |= {one.path: SetStorage(one) for one in plan.storages}
    output, serving = Output(), served(simulated, sky, time.monotonic, address, port)
    with suppress(KeyboardInterrupt), serving as addresses:
        output.say(*(f"--device {name}={where}" for name, where in addresses.items()))
        output.say(f"the sky begins at {prepared.local_start()}")
        while not sky.is_over(time.monotonic()):
            time.sleep(0.2)
