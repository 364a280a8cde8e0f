"""The command line: `heliarch`. Each command is a function in a file of its own."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Final, NoReturn

from cyclopts import App, Group, Parameter

from bus_schemas.errors import InputError
from heliarch.cli.boundary import BAD_INPUT, OK, boundary
from heliarch.cli.options import OPTIONS

COMMANDS: Final = {
    "Run": ("launch", "node", "simulate", "timing", "conform", "inverters", "scenarios", "order"),
    "Look": ("view", "report", "inspect", "verify", "replay"),
    "Compare": ("compare", "diff"),
    "Files": ("export",),
    "Set up": ("init", "doctor", "keys"),
}
"""The commands under the headings of `heliarch --help`."""

_DEBUG: Final = "--debug"
"""Of all commands: show the traceback of an unexpected error."""


def _default_text(value: object) -> str | None:
    if value is None or value is False:
        return None
    return f"{value:g}" if isinstance(value, float) else str(value)


def _first_line(name: str) -> str:
    """Return the first line of a command's docstring, which need not be imported for it."""
    text = (Path(__file__).parent / f"{name}.py").read_text(encoding="utf-8")
    functions = (one for one in ast.parse(text).body if isinstance(one, ast.FunctionDef))
    command = next(one for one in functions if one.name == name)
    return (ast.get_docstring(command) or "").partition("\n\n")[0]


def _make_app(*, with_first_lines: bool = False) -> App:
    """Return the program; `with_first_lines` for its own help, which describes each command."""
    made = App(
        name="heliarch",
        help="Run a utility-scale solar plant's controllers as a team of processes.",
        help_epilogue="With --debug, any command shows the traceback of an unexpected error.",
        version=lambda: f"heliarch {version('heliarch')}",
        help_format="markdown",
        default_parameter=Parameter(negative=(), show_default=_default_text),
        group_commands=Group.create_ordered("Help"),
        group_parameters=OPTIONS,
        result_action="return_value",
        print_error=False,
        exit_on_error=False,
        suppress_keyboard_interrupt=False,
    )
    for heading, names in COMMANDS.items():
        group = Group.create_ordered(heading)
        for name in names:  # By its path: only the command that the user named is imported.
            text = _first_line(name) if with_first_lines else None
            made.command(f"heliarch.cli.{name}:{name}", name=name, group=group, help=text)
    made.register_install_completion_command()
    return made


app: Final = _make_app()


def run_command(words: Sequence[str]) -> NoReturn:
    """Run the command that the user named, and leave with its exit status.

    Commands return their exit status, or None for success.
    """
    debug = _DEBUG in words
    words = [word for word in words if word != _DEBUG]
    with boundary(words, debug=debug):
        if not words or words[0] in app.help_flags:
            _make_app(with_first_lines=True).help_print([])
            status = OK if words else BAD_INPUT
        else:
            command, bound, rest = app.parse_args(checked(words))
            if "given" in rest:
                options = (word.partition("=")[0] for word in words if word[:2] == "--")
                bound.arguments["given"] = frozenset(one.replace("_", "-") for one in options)
            status = command(*bound.args, **bound.kwargs)
        sys.stdout.flush()
    sys.exit(status or OK)


def checked(words: Sequence[str]) -> list[str]:
    """Refuse empty words; give a `--report` that no file *.html follows an empty value."""
    checked = []
    for before, word, after in zip(["", *words], words, [*words[1:], ""], strict=False):
        # `--out "$FOLDER"` without a FOLDER: an empty path would mean this folder.
        if not word or (word.startswith("--") and word.endswith("=")):
            option = next((one for one in (word, before) if one[:2] == "--"), "an argument")
            raise InputError(f"{option.rstrip('=')}: expected a value, got nothing")
        if re.search("[\ud800-\udfff]", word):
            raise InputError(f"{word}: expected UTF-8, got bytes that are not")
        is_bare = word == "--report" and not after.endswith(".html")
        checked.append("--report=" if is_bare else word)
    return checked
