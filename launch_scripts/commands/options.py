"""Options that several commands share: the same option has the same name everywhere."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from agents.settings import Scheme
from bus_schemas.errors import InputError
from launch_scripts.scenarios.run_options import TimeOptions

if TYPE_CHECKING:
    from launch_scripts.scenarios.scenario import ScenarioFile


def file_in_folder(option: typer.CallbackParam, value: str | None) -> str | None:
    """Refuse a place where no file can be written, before any work is done."""
    if value in (None, "", "-"):
        return value
    path = Path(str(value))
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise InputError(f"{option.opts[0]}: expected a file in an existing folder, got {path}")
    return value


RunArgument: TypeAlias = Annotated[
    Path,
    typer.Argument(help="Folder of a run, or its run.mcap.", metavar="RUN", show_default=False),
]
ScenarioArgument: TypeAlias = Annotated[
    str,
    typer.Argument(
        help="A shipped scenario (see `heliarch scenarios`) or a TOML file.", metavar="SCENARIO"
    ),
]

# What is run -------------------------------------------------------------------------------------

SeedOption: TypeAlias = Annotated[int | None, typer.Option(help="Seed of the synthetic clouds.")]
SchemeOption: TypeAlias = Annotated[
    Scheme | None, typer.Option(help="How maximum powers are estimated.")
]
SettingsOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Change a field of the scenario: commitment.share=0.5. May be given several times.",
        metavar="FIELD=VALUE",
    ),
]
DataOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Folder of the data files that the scenario names.", metavar="DIR"),
]
WorkersOption: TypeAlias = Annotated[
    int, typer.Option(min=1, max=256, help="Processes that share the work.")
]

# Which part of a recording -----------------------------------------------------------------------

FirstOption: TypeAlias = Annotated[
    str | None,
    typer.Option("--from", help="First cycle: 13:49:00, 90s, or its number.", metavar="TIME"),
]
LastOption: TypeAlias = Annotated[
    str | None, typer.Option("--to", help="Last cycle, in the same forms.", metavar="TIME")
]
NodesOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--nodes",
        help="Only these nodes: c2/inv07,c1/*,central (c1/*: c1 and all below it).",
        metavar="NODES",
    ),
]
SignalsOption: TypeAlias = Annotated[
    str | None,
    typer.Option(help="Only these signals, separated by commas: impp,residual.", metavar="NAMES"),
]

# The page of a run -------------------------------------------------------------------------------

PagePortOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        min=0, max=65535, help="Port of the page; default: any that is free.", metavar="PORT"
    ),
]
PageAddressOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Address of the page; default 127.0.0.1, for this machine only. 0.0.0.0 is for other "
        "hosts too, with the token that is printed.",
        metavar="ADDRESS",
    ),
]

# What comes out of it ----------------------------------------------------------------------------

ReportOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--report",
        help="Write an HTML page to a file whose name ends in .html, or to a default path, which "
        "is printed.",
        metavar="[FILE.html]",
        callback=file_in_folder,
        show_default=False,
    ),
]
"""None: no page; empty: the default file."""

JsonOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--json",
        help="Write the result as JSON; - is standard output.",
        metavar="FILE",
        callback=file_in_folder,
    ),
]

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
    page_port: PagePortOption = None
    page_address: PageAddressOption = None


@dataclass(frozen=True, slots=True)
class ResultOptions:
    """Where data come from and results go."""

    data: DataOption = None
    report: ReportOption = None
    json: JsonOption = None


@dataclass(frozen=True, slots=True)
class FileOptions(ResultOptions):
    """The same of a run, which has a folder.

    --out DIR: Folder of the run; default runs/NAME-TIME.
    """

    out: Path | None = None


def refuse_others(context: typer.Context, allowed: Collection[str], why: str) -> None:
    """Refuse what the command line has beside the options that are allowed here."""
    for option in context.command.params:
        name = str(option.name)
        source = context.get_parameter_source(name)
        if source and source.name == "COMMANDLINE" and name not in allowed:
            raise InputError(f"{option.opts[0]}: {why}")


def changed_scenario(
    scenario: str, data: Path | None, settings: Sequence[str] | None
) -> ScenarioFile:
    """Load a scenario, and change the fields that `--set` names."""
    from launch_scripts.scenarios.scenario import load_scenario
    from studies.compare.cases import with_settings

    return with_settings(load_scenario(scenario, data), settings or ())


def with_options(command: Callable[..., int | None]) -> Callable[..., int | None]:
    """Return a command as typer takes it, whose options docstrings describe.

    `--option METAVAR (parameter): help` describes a parameter of the command, or a field of a
    dataclass that it takes; the name is left out where it is that of the option. Each field of such
    a dataclass is an option of its own.
    """
    taken = inspect.signature(command, eval_str=True).parameters.values()
    groups: dict[str, Any] = {
        taker.name: taker.annotation for taker in taken if is_dataclass(taker.annotation)
    }

    def expanded(**given: Any) -> int | None:
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        return command(**given)

    expanded.__doc__, described = _described(command)
    options: list[inspect.Parameter] = []
    for taker in taken:
        if group := groups.get(taker.name):
            options += inspect.signature(group, eval_str=True).parameters.values()
            for owner in group.__mro__[:-1]:
                described |= _described(owner)[1]
        else:
            options.append(taker)
    keyword = []
    for option in options:
        kind, described_as = option.annotation, described.pop(option.name, None)
        kind = kind if described_as is None else Annotated[kind, described_as]
        keyword.append(option.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=kind))
    assert not described, f"{command.__name__} takes no {', '.join(described)}"
    expanded.__signature__ = inspect.Signature(keyword)  # type: ignore[attr-defined]
    expanded.__annotations__ = {option.name: option.annotation for option in keyword}
    return expanded


def _described(owner: Callable[..., object]) -> tuple[str, dict[str, Any]]:
    """Take the options out of a docstring; return the rest, and them by parameter."""
    text, *entries = re.split(r"\n(?=--[\w-]+.*: )", inspect.getdoc(owner) or "")
    found = {}
    for entry in entries:
        head, _, words = entry.partition(": ")
        option, *rest = head.split()
        named = {word[:1] == "(": word.strip("()") for word in rest}
        name = named.get(True, option[2:].replace("-", "_"))
        found[name] = typer.Option(option, help=" ".join(words.split()), metavar=named.get(False))
    return text.rstrip(), found
