"""`heliarch keys`: certificates by which a plant's agents identify each other."""

from __future__ import annotations

from pathlib import Path

from bus_schemas.errors import InputError
from launch_scripts.commands.options import changed_scenario
from launch_scripts.commands.output import say, write_json
from launch_scripts.scenarios.run_options import RunOptions
from studies.tables import console_for


def keys(
    scenario: str = "oahu",
    out: Path | None = None,
    days: float = 365.0,
    address: list[str] | None = None,
    settings: list[str] | None = None,
    data: Path | None = None,
    json: str | None = None,
) -> None:
    """Make a certificate authority for a plant, and a certificate for each of its agents.

    Run it again to renew the certificates, also while a run is on; the private
    keys stay the same. Give a device only its own certificate, its own key and
    ca.pem. Keep ca.key secret: it can sign certificates.

    --out DIR: Folder of the keys; default keys/PLANT.
    --days NUMBER ..3650: Days for which the certificates are valid.
    --address ADDRESS: An address at which agents listen, besides 127.0.0.1. May be given several
        times.
    Example: heliarch keys oahu && heliarch launch oahu --secure --duration 30
    """
    from launch_scripts.scenarios.plant_keys import make_keys
    from launch_scripts.scenarios.preparation import prepare

    if not days > 0.0:
        raise InputError(f"--days: expected more than 0, got {days:g}")
    plan = prepare(changed_scenario(scenario, data, settings), RunOptions(), "keys").plan
    folder = out or Path("keys") / plan.plant
    agents = plan.tree.agents()
    expires, is_new = make_keys(folder, plan.plant, agents, days, address or ())
    write_json({"folder": str(folder), "agents": agents, "expires": expires.isoformat()}, json)
    until = f"{expires:%Y-%m-%d %H:%M} UTC"
    authority = "a new authority" if is_new else "the same authority"
    say(
        console_for(json), f"{folder}: {len(agents)} certificates, {authority}, valid until {until}"
    )
