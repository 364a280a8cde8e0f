"""The command line: `heliarch`. Each command is one file in `launch_scripts/commands`."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from importlib.metadata import version
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, Final

import typer

from launch_scripts.commands.boundary import BAD_INPUT, CommandLine
from launch_scripts.commands.options import add_command

COMMANDS: Final = {
    "Run": ("launch", "node", "simulate", "timing", "conform", "inverters", "scenarios"),
    "Look": ("view", "report", "inspect", "verify", "replay"),
    "Compare": ("compare", "clusters", "delays", "campaign"),
    "Files": ("export", "recover"),
    "Set up": ("doctor", "keys"),
}
"""The commands under the headings of `heliarch --help`."""


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"heliarch {version('heliarch')}")
        raise typer.Exit


def heliarch(
    context: typer.Context,
    show_version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    """Run a utility-scale solar plant's controllers as a team of processes."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(BAD_INPUT)


app = typer.Typer(name="heliarch", cls=CommandLine, pretty_exceptions_enable=False)
app.callback(invoke_without_command=True)(heliarch)
for _heading, _names in COMMANDS.items():
    for _name in _names:
        _module = import_module(f"launch_scripts.commands.{_name}")
        add_command(app, getattr(_module, _name), _heading)


def main() -> None:
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        for name in ("stdout", "stderr"):
            if getattr(sys, name) is None:  # As `>&-` has it, in a script that a service starts.
                setattr(sys, name, nowhere)
        if isinstance(sys.stdout, TextIOWrapper):
            sys.stdout.reconfigure(errors="replace")  # Not every terminal has the lines of a tree.
        app()
