"""`heliarch scenarios`: what comes with Heliarch."""

from __future__ import annotations

from typing import Final

import typer

EXAMPLE: Final = "heliarch scenarios"


def scenarios() -> None:
    """List the scenarios that come with Heliarch."""
    from launch_scripts.scenarios.scenario import (
        load_scenario,
        shipped_scenarios,
    )

    for name in shipped_scenarios():
        typer.echo(f"{name:14} {load_scenario(name).scenario.title}")
