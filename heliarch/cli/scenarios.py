"""`heliarch scenarios`: what comes with Heliarch."""

from __future__ import annotations

from typing import Final

from heliarch.cli.options import Json
from heliarch.cli.output import write_json
from results.tables import Table, console_for, key_column, print_table, word_column

_NOTE: Final = "--data: needs measured data, which does not come with Heliarch; see docs/data.md"


def scenarios(*, json: Json = None) -> None:
    """List the scenarios that come with Heliarch.

    Example: `heliarch scenarios`
    """
    from scenarios.scenario import load_scenario, shipped_scenarios

    listed = map(load_scenario, shipped_scenarios())
    rows = [(one.scenario.name, one.needs_data, one.scenario.title) for one in listed]
    columns = (
        key_column("scenario", "name"),
        word_column("data", "needs_data"),
        word_column("title"),
    )
    shown = [(name, "--data" if needs else "", title) for name, needs, title in rows]
    print_table(console_for(json), Table("Scenarios", columns, shown, (_NOTE,)))
    write_json([dict(zip(("name", "needs_data", "title"), row, strict=True)) for row in rows], json)
