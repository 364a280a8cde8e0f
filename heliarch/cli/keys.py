"""`heliarch keys`: certificates by which a plant's agents identify each other."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from heliarch.cli.options import FILES, Data, Json, Scenario, Settings, changed_scenario
from heliarch.cli.output import Output
from scenarios.run_options import RunOptions


def keys(
    scenario: Scenario = "oahu",
    /,
    *,
    days: Annotated[float, Parameter(validator=Number(gt=0, lte=3650))] = 365.0,
    address: Annotated[list[str] | None, Parameter(metavar="ADDRESS")] = None,
    settings: Settings = None,
    data: Data = None,
    out: Annotated[Path | None, Parameter(metavar="DIR", group=FILES)] = None,
    json: Json = None,
) -> None:
    """Make the certificates of a plant's agents.

    A certificate authority for the plant, and a certificate for each agent.

    Run it again to renew the certificates, also during a run; the private keys stay the same.
    Give a device only its own certificate, its own key and ca.pem. Keep ca.key secret: it can sign
    certificates.

    Example: `heliarch keys oahu && heliarch launch oahu --secure --duration 30`

    Parameters
    ----------
    days
        Days for which the certificates are valid.
    address
        An address at which agents listen, besides 127.0.0.1. May be given several times.
    out
        Folder of the keys; default keys/PLANT.
    """
    from bus_schemas.tree import OPERATOR
    from scenarios.elsewhere import read_address
    from scenarios.plant_keys import make_keys
    from scenarios.preparation import prepare

    for one in address or ():
        read_address(one)
    plan = prepare(changed_scenario(scenario, data, settings), RunOptions(), "keys").plan
    folder, output = out or Path("keys") / plan.plant, Output(json)
    agents = (*plan.tree.agents(), OPERATOR)
    expires, is_new = make_keys(folder, plan.plant, agents, days, address or ())
    output.write({"folder": str(folder), "agents": agents, "expires": expires.isoformat()})
    authority = "a new authority" if is_new else "the same authority"
    until = f"valid until {expires:%Y-%m-%d %H:%M} UTC"
    output.say(f"{folder}: {len(agents)} certificates, {authority}, {until}")
