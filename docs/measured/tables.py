"""What the measured tables have in common: Markdown, and commands as a reader gives them."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, Final

from heliarch import load_scenario
from launch_scripts.scenarios.scenario import ScenarioFile

DOCUMENTS: Final = Path(__file__).parents[1]
WORKERS: Final = 2

Lines = Iterator[str]
Tables = dict[str, Callable[[Path], Lines]]


def header(titles: Iterable[str]) -> Lines:
    """Write the heading of a table."""
    titles = list(titles)
    yield row(titles)
    yield "|" + "---|" * len(titles)


def row(cells: Iterable[object]) -> str:
    """Return a row of a table."""
    return f"| {' | '.join(map(str, cells))} |"


@cache
def heliarch(command: str, *options: str) -> Any:
    """Run a command and return its JSON."""
    with tempfile.TemporaryDirectory() as folder:
        words = [*command.split(), *options, "--json", "result.json"]
        subprocess.run(
            [sys.executable, "-m", "launch_scripts", *words],
            cwd=folder,
            stdout=subprocess.DEVNULL,
            check=True,
        )
        return json.loads((Path(folder) / "result.json").read_bytes())


def hope(data: Path) -> ScenarioFile:
    """Return the scenario of the HOPE hour."""
    return load_scenario("hope-melpitz", data / "hope-melpitz-1s")


def plant(data: Path) -> ScenarioFile:
    """Return the scenario of the real plant."""
    return load_scenario("plant20mw", data / "plant20mw-combiners-10s")


def write_table(page: str, name: str, lines: Iterable[str]) -> None:
    """Write a table into its place in a document.

    Without lines it stays as it is: its measurements are not there.
    """
    table = "\n".join(lines)
    if not table:
        return
    text = (DOCUMENTS / page).read_text(encoding="utf-8")
    marked = rf"(<!-- measured: {re.escape(name)} -->\n).*?(<!-- end -->)"
    # A table has no backslash: it may stand in the replacement.
    text, count = re.subn(marked, rf"\g<1>{table}\n\g<2>", text, flags=re.S)
    (DOCUMENTS / page).write_text(text, encoding="utf-8")
    if count != 1:
        sys.exit(f"{page}: expected one table {name}, got {count}")
