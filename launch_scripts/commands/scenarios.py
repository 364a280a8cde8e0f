"""`heliarch scenarios`: what comes with Heliarch."""

from __future__ import annotations

from launch_scripts.commands.output import say, write_json
from studies.tables import console_for


def scenarios(json: str | None = None) -> None:
    """List the scenarios that come with Heliarch.

    Example: heliarch scenarios
    """
    from launch_scripts.scenarios.scenario import load_scenario, shipped_scenarios

    titles = {name: load_scenario(name).scenario.title for name in shipped_scenarios()}
    write_json([{"name": name, "title": title} for name, title in titles.items()], json)
    say(console_for(json), *(f"{name:14} {title}" for name, title in titles.items()))
