"""Options that several commands share: the same option has the same name and text everywhere."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Group, Parameter
from cyclopts.validators import Number

from bus_schemas.errors import InputError, not_one_of
from scenarios.run_options import PLANT, Whole

if TYPE_CHECKING:
    from scenarios.scenario import ScenarioFile

OPTIONS: Final = Group.create_ordered("Options", sort_key=0)
PAGE: Final = Group.create_ordered("Page")
FILES: Final = Group.create_ordered("Files")
"""The panels of `--help`, beside those of the options of a run."""


def new_file(kind: object, value: str | None) -> None:
    """Refuse a path at which no result can be written, before any work is done."""
    if not value or value == "-":
        return
    if value.startswith("-"):  # The next option.
        raise ValueError("Expected a file.")
    path = Path(value)
    # `--json plant.toml`, as if `--json` were a switch, must not replace the scenario.
    is_input = path.suffix in {".toml", ".mcap"}
    place = path if path.exists() else path.absolute().parent
    if is_input or path.is_dir() or not os.access(place, os.W_OK):
        raise ValueError("Expected a file for the result that can be written.")


def new_table(kind: object, value: str | None) -> None:
    if value == "-":
        raise ValueError("Expected a file.")
    new_file(kind, value)


def is_installed(package: str) -> bool:
    try:
        return find_spec(package) is not None
    except (ValueError, ModuleNotFoundError):
        return False


def _new_page(kind: object, value: str | None) -> None:
    if value is not None and not is_installed("plotly"):  # Before any work is done.
        raise ValueError("A page needs plotly: pip install 'heliarch[report]'.")
    if value and not value.endswith(".html"):
        raise ValueError("Expected a file whose name ends in .html.")
    new_file(kind, value)


# Arguments and single options ---------------------------------------------------------------------


def _option(name: str, metavar: str | None, group: Group, text: str, **more: Any) -> Parameter:
    return Parameter(name, metavar=metavar, group=group, help=text, **more)


_Text = str | None
_Texts = list[str] | None

Run = Annotated[Path, Parameter(help="Folder of a run, or its run.mcap.")]
Scenario = Annotated[
    str, Parameter(help="A shipped scenario (see `heliarch scenarios`) or a TOML file.")
]
_SET = "Change a field of the scenario: commitment.share=0.5. May be given several times."
Settings = Annotated[_Texts, _option("--set", "FIELD=VALUE", PLANT, _SET)]
_DATA = "Folder of the data files that the scenario names."
Data = Annotated[Path | None, _option("--data", "DIR", FILES, _DATA)]
_JSON = "Write the result as JSON; - is standard output."
_AS_FILE: Final = {"allow_leading_hyphen": True, "validator": new_file}
Json = Annotated[_Text, _option("--json", "FILE", FILES, _JSON, **_AS_FILE)]
_JUNIT = "Write a JUnit XML file with a test case for each row."
Junit = Annotated[Path | None, _option("--junit", "FILE.xml", FILES, _JUNIT)]
_REPORT = (
    "Write an HTML page to a file whose name ends in .html, or to a default path, which is printed."
)
Report = Annotated[_Text, _option("--report", "[FILE.html]", FILES, _REPORT, validator=_new_page)]
"""None is no page, an empty text the default file."""

_WORKERS = "Processes that share the work."
_SOME: Final = Number(gte=1, lte=256)
Workers = Annotated[Whole, _option("--workers", None, OPTIONS, _WORKERS, validator=_SOME)]
_FROM = "First cycle: local time (13:49:00), seconds (90, 15m) or a cycle (c90)."
Start = Annotated[_Text, _option("--from", "TIME", OPTIONS, _FROM)]
_TO = "The cycle before which to end, in the same forms."
End = Annotated[_Text, _option("--to", "TIME", OPTIONS, _TO)]
_NODES = "Only these nodes: `c2/inv07,c1/*,central` (`c1/*`: c1 and all below it; `*`: all)."
Nodes = Annotated[_Text, _option("--nodes", "NODES", OPTIONS, _NODES)]
_SIGNALS = "Only these signals, separated by commas: impp,residual."
Signals = Annotated[_Text, _option("--signals", "NAMES", OPTIONS, _SIGNALS)]
_TOLERANCE = "Largest difference between numbers that count as equal."
Tolerance = Annotated[
    float, _option("--tolerance", "X", OPTIONS, _TOLERANCE, validator=Number(gte=0))
]
Port = Annotated[Whole, Parameter(metavar="PORT", validator=Number(gte=0, lte=65535))]
_PAGE_PORT = "Port of the page; default: any that is free."
PagePort = Annotated[Port | None, _option("--page-port", "PORT", PAGE, _PAGE_PORT)]
_PAGE_ADDRESS = (
    "Address of the page; default 127.0.0.1, for this machine only. 0.0.0.0 is for other hosts "
    "too, which need the token that is printed."
)
PageAddress = Annotated[_Text, _option("--page-address", "ADDRESS", PAGE, _PAGE_ADDRESS)]

Given = Annotated[frozenset[str], Parameter(parse=False)]
"""Names of the options that the user gave: a command with several uses refuses those of others."""

# Groups of options --------------------------------------------------------------------------------


@Parameter("*", group=PAGE)
@dataclass(frozen=True)
class PageOptions:
    """The page that shows a run.

    Parameters
    ----------
    page
        Show the run in a browser while it runs.
    orders
        Let the page give orders to the plant of `launch`; whoever has its address may.
    """

    page: bool = False
    orders: bool = False
    page_port: PagePort = None
    page_address: PageAddress = None

    def __post_init__(self) -> None:
        if not self.page and (self.page_port is not None or self.page_address is not None):
            raise InputError.of("--page-address, --page-port", "expected --page with it")
        if self.orders and not self.page:
            raise InputError.of("--orders", "expected --page with it")


@Parameter("*", group=FILES)
@dataclass(frozen=True)
class ResultOptions:
    """Where data come from and results go."""

    data: Data = None
    report: Report = None
    json: Json = None


@Parameter("*", group=FILES)
@dataclass(frozen=True)
class FileOptions(ResultOptions):
    """The same, and the folder of a run.

    Parameters
    ----------
    out
        Folder of the run; default runs/NAME-TIME.
    """

    out: Annotated[Path | None, Parameter(metavar="DIR")] = None


def refuse_others(given: frozenset[str], known: set[str], why: str) -> None:
    """Refuse options that a command takes, but not in this use of it."""
    for name in sorted(given - known):
        raise InputError(f"{name}: {why}")


def is_run(path: Path) -> bool:
    """Whether a path names a run rather than a scenario. The run need not exist."""
    from scenarios.scenario import shipped_scenarios

    is_elsewhere = len(path.parts) > 1 and path.suffix != ".toml"
    if is_elsewhere or path.suffix == ".mcap" or (path / "run.mcap").exists():
        return True
    if path.suffix != ".toml" and str(path) not in shipped_scenarios():
        others = "a run, a scenario *.toml, or one of "
        raise InputError(f"{path}: {not_one_of(shipped_scenarios(), str(path), others)}")
    return False


def changed_scenario(
    scenario: str, data: Path | None, settings: Sequence[str] | None
) -> ScenarioFile:
    from scenarios.scenario import load_scenario
    from scenarios.settings import with_single_settings

    return with_single_settings(load_scenario(scenario, data), settings or ())
