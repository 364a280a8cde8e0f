"""The command line: `heliarch`. Each command is one file in `launch_scripts/commands`."""

from __future__ import annotations

import sys
from importlib.metadata import version
from types import ModuleType
from typing import Annotated, Final

import typer

from launch_scripts.commands import (
    clusters,
    compare,
    delays,
    export,
    inspect,
    launch,
    recover,
    replay,
    report,
    scenarios,
    simulate,
    timing,
    verify,
)

COMMANDS: Final[dict[str, tuple[ModuleType, ...]]] = {
    "Run": (launch, simulate, timing, scenarios),
    "Look": (report, inspect, verify, replay),
    "Compare": (compare, clusters, delays),
    "Files": (export, recover),
}
"""The commands under the headings of `heliarch --help`."""


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"heliarch {version('heliarch')}")
        raise typer.Exit


def heliarch(
    show_version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    """Run a utility-scale solar plant's controllers as a team of processes."""


def _assembled() -> typer.Typer:
    """Return the command line with all its commands."""
    found = typer.Typer(name="heliarch", no_args_is_help=True, pretty_exceptions_enable=False)
    found.callback()(heliarch)
    for heading, modules in COMMANDS.items():
        for module in modules:
            name = module.__name__.rpartition(".")[2]
            decorate = found.command(
                name, rich_help_panel=heading, epilog=f"Example: {module.EXAMPLE}"
            )
            decorate(getattr(module, name))
    return found


app = _assembled()


def main() -> None:
    """Run the command line. Ctrl-C while a command is still being loaded ends it in one line."""
    try:
        app()
    except KeyboardInterrupt:
        sys.stderr.write("heliarch: interrupted\n")
        sys.exit(130)
