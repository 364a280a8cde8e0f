"""Options that several commands share: the same option has the same name everywhere."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from bus_schemas.errors import InputError
from launch_scripts.commands.boundary import Command
from launch_scripts.scenarios.run_options import TimeOptions

if TYPE_CHECKING:
    from launch_scripts.scenarios.scenario import ScenarioFile


def result_file(option: typer.CallbackParam, value: str | None) -> str | None:
    """Refuse a place where no result can be written, before any work is done."""
    if not value or (value == "-" and option.name == "json"):
        return value
    path, name = Path(value), option.opts[0]
    if option.name == "report" and path.suffix != ".html":
        raise InputError(f"{name}: expected a file whose name ends in .html, got {path}")
    # `--json plant.toml`, as if `--json` were a switch, must not replace the scenario.
    is_input = path.suffix in {".toml", ".mcap"}
    place = path if path.exists() else path.absolute().parent
    if value == "-" or is_input or path.is_dir() or not os.access(place, os.W_OK):
        raise InputError(f"{name}: expected a file for the result that can be written, got {path}")
    return value


_SHARED: Final = """
RUN: Folder of a run, or its run.mcap.
SCENARIO: A shipped scenario (see `heliarch scenarios`) or a TOML file.
--seed NUMBER: Seed of the synthetic clouds.
--scheme: How maximum powers are estimated.
--set FIELD=VALUE (settings): Change a field of the scenario: commitment.share=0.5. May be given
    several times.
--data DIR: Folder of the data files that the scenario names.
--workers NUMBER 1..256: Processes that share the work.
--from TIME (start): First cycle: 13:49:00, 90s, or its number.
--to TIME (end): Last cycle, in the same forms.
--nodes NODES: Only these nodes: c2/inv07,c1/*,central (c1/*: c1 and all below it).
--signals NAMES: Only these signals, separated by commas: impp,residual.
--page-port PORT 0..65535: Port of the page; default: any that is free.
--page-address ADDRESS: Address of the page; default 127.0.0.1, for this machine only. 0.0.0.0 is
    for other hosts too, which need the token that is printed.
--report [FILE.html]: Write an HTML page to a file whose name ends in .html, or to a default path,
    which is printed.
--json FILE: Write the result as JSON; - is standard output.
"""
"""Help texts for every command that does not describe these itself. `--report`: None is no page,
an empty value is the default file."""

_WRITTEN: Final = {"report", "json", "csv"}
"""Options that name a file to write."""

# Groups, for the commands that run a plant -------------------------------------------------------


@dataclass(frozen=True)
class SpanOptions(TimeOptions):
    """Which part of a scenario is run, and how fast.

    --pace PACE: Simulated seconds per second: 1 is real time, max is lockstep.
    """

    pace: str | None = None


@dataclass(frozen=True, slots=True)
class PageOptions:
    """The page that shows a run.

    --page: Show the run in a browser, while it goes on.
    """

    page: bool = False
    page_port: int | None = None
    page_address: str | None = None


@dataclass(frozen=True, slots=True)
class ResultOptions:
    """Where data come from and results go."""

    data: Path | None = None
    report: str | None = None
    json: str | None = None


@dataclass(frozen=True, slots=True)
class FileOptions(ResultOptions):
    """The same, and the folder of a run.

    --out DIR: Folder of the run; default runs/NAME-TIME.
    """

    out: Path | None = None


def refuse_others(context: typer.Context, allowed: Collection[str], why: str) -> None:
    """Refuse options other than the allowed ones."""
    for option in context.command.params:
        name = str(option.name)
        source = context.get_parameter_source(name)
        if source and source.name == "COMMANDLINE" and name not in allowed:
            raise InputError(f"{option.opts[0]}: {why}")


def is_run(path: Path) -> bool:
    """Whether a path names a run rather than a scenario. The run need not exist."""
    from launch_scripts.scenarios.scenario import shipped_scenarios

    is_elsewhere = len(path.parts) > 1 and path.suffix != ".toml"
    if is_elsewhere or path.suffix == ".mcap" or (path / "run.mcap").exists():
        return True
    if path.suffix != ".toml" and str(path) not in shipped_scenarios():
        names = ", ".join(shipped_scenarios())
        raise InputError(f"{path}: expected a run, a scenario *.toml, or one of {names}")
    return False


def changed_scenario(
    scenario: str, data: Path | None, settings: Sequence[str] | None
) -> ScenarioFile:
    """Load a scenario, and change the fields that `--set` names."""
    from launch_scripts.scenarios.scenario import load_scenario
    from studies.compare.cases import with_settings

    return with_settings(load_scenario(scenario, data), settings or ())


def add_command(app: typer.Typer, command: Callable[..., int | None], heading: str) -> None:
    """Add a command. Docstrings describe its options and arguments; its own ends with an example.

    `--option METAVAR 1..9 (parameter): help` describes a parameter of the command, or a field of a
    dataclass that it takes: each field is an option. `(parameter)` is left out if it equals the
    option's name; a number may have a range. `ARGUMENT (parameter): help` describes an argument.
    """
    taken = inspect.signature(command, eval_str=True).parameters.values()
    groups: dict[str, Any] = {
        taker.name: taker.annotation for taker in taken if is_dataclass(taker.annotation)
    }

    def expanded(**given: Any) -> int | None:
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        return command(**given)

    text, _, example = (inspect.getdoc(command) or "").rpartition("\nExample: ")
    expanded.__doc__, described = _described(text)
    options: list[inspect.Parameter] = []
    for taker in taken:
        if group := groups.get(taker.name):
            options += inspect.signature(group, eval_str=True).parameters.values()
            for owner in group.__mro__[:-1]:
                described |= _described(inspect.getdoc(owner) or "")[1]
        else:
            options.append(taker)
    shared, keyword = _described(_SHARED)[1], []
    for option in options:
        kind = option.annotation
        if words := described.pop(option.name, None) or shared.get(option.name):
            if kind in (bool, bool | None):
                words.metavar = ""
            kind = Annotated[kind, words]
        keyword.append(option.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=kind))
    assert not described, f"{command.__name__} takes no {', '.join(described)}"
    expanded.__signature__ = inspect.Signature(keyword)  # type: ignore[attr-defined]
    expanded.__annotations__ = {option.name: option.annotation for option in keyword}
    epilog = f"Example: {' '.join(example.split())}"
    name = command.__name__
    app.command(name, cls=Command, rich_help_panel=heading, epilog=epilog)(expanded)


_ENTRY: Final = re.compile(r"\n(?=(?:--[\w-]+|[A-Z]{3}).*: )")
_HEAD: Final = re.compile(r"(--[\w-]+)? ?(\S*[A-Z]\S*)? ?(?:(\d*)\.\.(\d*))? ?(?:\((\w+)\))?")


def _described(text: str) -> tuple[str, dict[str, Any]]:
    """Split a docstring into its text and the descriptions of parameters, by name."""
    rest, *entries = _ENTRY.split(text)
    found: dict[str, Any] = {}
    for entry in entries:
        head, _, words = entry.partition(": ")
        parts = _HEAD.fullmatch(head)
        assert parts, head
        option, metavar, least, most, name = parts.groups()
        shown: dict[str, Any] = {"help": " ".join(words.split()), "metavar": metavar}
        if option is None:
            found[name or metavar.lower()] = typer.Argument(**shown)
            continue
        name = name or option[2:].replace("-", "_")
        found[name] = typer.Option(
            option,
            **shown,
            min=int(least) if least else None,
            max=int(most) if most else None,
            callback=result_file if name in _WRITTEN else None,
        )
    return rest.rstrip(), found
