"""The command line: `heliarch`. Each command is one file in `launch_scripts/commands`."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
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


def heliarch(
    context: typer.Context,
    show_version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    """Run a utility-scale solar plant's controllers as a team of processes."""
    if show_version:
        typer.echo(f"heliarch {version('heliarch')}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(BAD_INPUT)


app = typer.Typer(
    name="heliarch",
    cls=CommandLine,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.callback(invoke_without_command=True)(heliarch)
for _heading, _names in COMMANDS.items():
    for _name in _names:
        _module = import_module(f"launch_scripts.commands.{_name}")
        add_command(app, getattr(_module, _name), _heading)
