"""`heliarch scenarios`: what comes with Heliarch."""

from __future__ import annotations

from typing import Final

from heliarch.cli.options import Json
from heliarch.cli.output import Output
from results.tables import Table, key_column, word_column

_NOTE: Final = "--data: needs measured data, which does not come with Heliarch; see docs/data.md"


def scenarios(*, json: Json = None) -> None:
    """List the scenarios that come with Heliarch.

    Example: `heliarch scenarios`
    """
    from scenarios.scenario import load_scenario, shipped_scenarios

    listed = [load_scenario(name) for name in shipped_scenarios()]
    rows = [
        (one.scenario.name, "--data" if one.needs_data else "", one.scenario.title)
        for one in listed
    ]
    columns = key_column("scenario"), word_column("data"), word_column("title")
    output = Output(json)
    output.show(Table("Scenarios", columns, rows, (_NOTE,)))
    output.write(
        [{"name": name, "needs_data": data != "", "title": title} for name, data, title in rows]
    )
