"""`heliarch clusters`: what virtual neighbours are worth beside other ways to choose clusters."""

# What does the work is imported when it runs: `--help` does not wait for it.
# ruff: noqa: PLC0415

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from math import isnan
from statistics import fmean, median
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import msgspec
import typer

from bus_schemas.errors import InputError
from launch_scripts.commands.options import (
    DataOption,
    DurationOption,
    EndOption,
    JsonOption,
    ScenarioArgument,
    SchemeOption,
    SettingsOption,
    StartOption,
)
from launch_scripts.commands.output import counted, say, write_json
from studies.tables import console_for

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from agents.control.clusters import ClusterSearch
    from agents.plan import RunPlan, Scheme
    from launch_scripts.scenarios.preparation import Preparation, RunOptions
    from launch_scripts.scenarios.scenario import ControlTable, ScenarioFile
    from studies.clusters.worth import Arrange, ClustersWorth

EXAMPLE: Final = "heliarch clusters oahu --random 50 --periods 1,30"

_PAPER_PERIODS_S: Final = (1.0, 10.0, 60.0)
"""How often the central controller acts: always, and as slow as the paper's two upper tiers."""

_SHARES: Final = (2, 3)
"""Columns of the table that are shares of cycles, with one digit."""

_LEGEND: Final = (
    "correlation: mean over the pairs that share a cluster, in the past and in the run itself",
    "to central: share of the cycles with an inverter in need that reach the central controller; "
    "able: of those cycles in which the plant as a whole has what is asked for",
    "control-caused: shortfall in % of the desired energy, with the central controller acting "
    "every so many seconds; begun lacking: that part of it in periods that began with the whole "
    "plant lacking",
)

_LONGEST_PERIOD: Final = 1e6
_MOST_RANDOM: Final = 1000


@dataclass(frozen=True, slots=True)
class _Study:
    """What a request came to.

    Attributes
    ----------
    title
        What was run.
    periods_s
        Periods of the central controller [s].
    ways
        For each way to choose clusters what it came to; of `random` once for each seed.
    orders
        For each order of help in the virtual clusters what it came to.
    search
        How the virtual clusters were found.
    remarks
        What a reader must know about the data.
    """

    title: str
    periods_s: tuple[float, ...]
    ways: dict[str, list[ClustersWorth]]
    orders: dict[str, ClustersWorth]
    search: ClusterSearch
    remarks: tuple[str, ...]


def clusters(
    scenario: ScenarioArgument = "oahu",
    start: StartOption = None,
    end: EndOption = None,
    duration: DurationOption = None,
    periods: Annotated[
        str | None,
        typer.Option(
            help="How often the central controller acts, seconds; default 1,10,60 as the cycle "
            "allows.",
            metavar="SECONDS",
        ),
    ] = None,
    random: Annotated[
        int, typer.Option(min=1, max=1000, help="How many random choices of clusters to try.")
    ] = 20,
    scheme: SchemeOption = None,
    learn: Annotated[
        str | None,
        typer.Option(
            help="Choose clusters from the first part of the run, as long as this; run the rest.",
            metavar="TIME",
        ),
    ] = None,
    settings: SettingsOption = None,
    data: DataOption = None,
    json: JsonOption = None,
) -> None:
    """Show what virtual neighbours are worth beside geographic and random clusters."""
    from launch_scripts.scenarios.preparation import RunOptions
    from launch_scripts.scenarios.scenario import load_scenario
    from studies.compare.cases import with_settings

    console = console_for(json)
    changed = with_settings(load_scenario(scenario, data), settings or ())
    options = RunOptions(start, duration, scheme=scheme, end=end)
    study = _studied(changed, options, learn, periods, random, console)
    _print(study, console)
    if json is not None:
        write_json(_document(study), json)


def _studied(
    scenario: ScenarioFile,
    options: RunOptions,
    learn: str | None,
    periods_text: str | None,
    seeds: int,
    console: Console,
) -> _Study:
    from agents.control.clusters import search_clusters
    from launch_scripts.scenarios.preparation import prepare
    from studies.clusters.worth import in_other_orders, past_of, worth_of

    control = scenario.scenario.control
    preparation = prepare(scenario, options, "clusters")
    plan = preparation.plan
    arrange, remarks = _arrange(scenario, options, learn, preparation)
    scheme = plan.scheme
    periods = _periods(periods_text, plan)
    past = past_of(arrange, control, len(plan.inverters))
    run = arrange(_chosen(control, "correlation"))
    orders = {
        name: worth_of(other, past, scheme, periods) for name, other in in_other_orders(run).items()
    }
    virtual = orders["least alike first"]
    ways = {"virtual": [virtual]}
    others = _other_ways(control, seeds)
    for name, table in counted(others, "clusters", len(others), console):
        ways.setdefault(name, []).append(worth_of(arrange(table), past, scheme, periods))
    return _Study(
        title=_title(run.plan, scheme),
        periods_s=tuple(period * plan.cycle_ns / 1e9 for period in periods),
        ways=ways,
        orders=orders,
        search=search_clusters(past.correlation, [len(cluster) for cluster in virtual.clusters]),
        remarks=remarks,
    )


def _arrange(
    scenario: ScenarioFile, options: RunOptions, learn: str | None, preparation: Preparation
) -> tuple[Arrange, tuple[str, ...]]:
    """Return how clusters are chosen, and what a reader must know about it."""
    from launch_scripts.scenarios.scenario import parse_duration_s
    from studies.clusters.worth import by_first_part, by_scenario
    from studies.compare.study import remarks_of

    if learn is None:
        return by_scenario(scenario, options), remarks_of(preparation)
    learn_s = parse_duration_s(learn, "--learn")
    remark = f"Clusters and neighbours were chosen from the first {learn_s:g} s; the rest was run."
    return by_first_part(preparation, learn_s), (*preparation.remarks, remark)


def _title(plan: RunPlan, scheme: Scheme) -> str:
    import pandas as pd

    start = pd.Timestamp(plan.start_time_ns, tz="UTC").tz_convert(plan.timezone)
    return (
        f"{plan.plant} from {start:%Y-%m-%d %H:%M:%S %Z}, {plan.cycles:,} cycles of "
        f"{plan.cycle_ns / 1e9:g} s, scheme {scheme}, actuator {plan.actuator}"
    )


def _periods(text: str | None, plan: RunPlan) -> tuple[int, ...]:
    """Every how many cycles the central controller acts, from periods in seconds."""
    cycle_s = plan.cycle_ns / 1e9
    if text is None:
        found = [_in_cycles(period_s, cycle_s) for period_s in _PAPER_PERIODS_S]
        return tuple(period for period in found if period) or (1,)
    periods = []
    for word in text.split(","):
        try:
            period = _in_cycles(float(word), cycle_s)
        except ValueError:
            period = None
        if period is None:
            raise InputError(
                f"--periods: expected multiples of the cycle, {cycle_s:g} s, in seconds with "
                f"commas between, such as 10,60, got {word}"
            )
        periods.append(period)
    return tuple(periods)


def _in_cycles(period_s: float, cycle_s: float) -> int | None:
    """Return a period in cycles; None if it is no whole number of them, at least one."""
    cycles = period_s / cycle_s
    if not 0.5 < cycles < _LONGEST_PERIOD or abs(cycles - round(cycles)) > 1e-6:
        return None
    return round(cycles)


def _chosen(
    control: ControlTable, way: Literal["correlation", "geographic", "random", "most-alike"]
) -> ControlTable:
    return msgspec.structs.replace(control, clusters=way)


def _other_ways(control: ControlTable, seeds: int) -> list[tuple[str, ControlTable]]:
    """Name and control table of each way to choose clusters but by least correlation."""
    random = _chosen(control, "random")
    return [
        ("geographic", _chosen(control, "geographic")),
        *(
            ("random", msgspec.structs.replace(random, clusters_seed=seed))
            for seed in range(1, seeds + 1)
        ),
        ("most alike", _chosen(control, "most-alike")),
    ]


def _print(study: _Study, console: Console) -> None:
    say(console, *study.remarks)
    console.print(_table(study))
    lines = (*_LEGEND, _needs(study), _orders(study), _search(study.search), *_members(study.ways))
    for line in lines:
        console.print(line, highlight=False)


def _table(study: _Study) -> Table:
    from rich.table import Table

    table = Table(title=study.title, title_justify="left")
    table.add_column("clusters", no_wrap=True)
    for heading in (
        "corre-\nlation,\npast",
        "corre-\nlation,\nrun",
        "to cen-\ntral %,\nall",
        "to cen-\ntral %,\nable",
        *(f"control-\ncaused %,\n{period_s:g} s" for period_s in study.periods_s),
        f"begun\nlacking,\n{study.periods_s[-1]:g} s",
    ):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, worths in study.ways.items():
        columns = list(zip(*map(_figures, worths), strict=True))
        if len(worths) == 1:
            table.add_row(name, *_texts(columns, fmean))
            continue
        table.add_row(f"{name}, mean of {len(worths)}", *_texts(columns, fmean))
        table.add_row("  least", *_texts(columns, min))
        table.add_row("  most", *_texts(columns, max))
    return table


def _figures(worth: ClustersWorth) -> tuple[float | None, ...]:
    """Return the figures of a row of the table."""
    return (
        worth.past_correlation,
        worth.run_correlation,
        worth.help.plant.central_percent,
        worth.help.plant_sufficient.central_percent,
        *(shortfall.control_caused_percent for shortfall in worth.shortfalls),
        worth.shortfalls[-1].begun_lacking_percent,
    )


def _texts(
    columns: Sequence[Sequence[float | None]], of_many: Callable[[list[float]], float]
) -> list[str]:
    """Text of each column's figure; a dash where there is none."""
    found = []
    for place, column in enumerate(columns):
        known = [value for value in column if value is not None and not isnan(value)]
        digits = 1 if place in _SHARES else 3
        found.append(f"{of_many(known):.{digits}f}" if known else "-")
    return found


def _needs(study: _Study) -> str:
    """Say what is the same however clusters are chosen."""
    (virtual,) = study.ways["virtual"]
    needy, cycles = virtual.help.plant.needy, virtual.help.cycles
    lacking = needy - virtual.help.plant_sufficient.needy
    return (
        f"An inverter was in need in {needy:,} of {cycles:,} cycles; in {lacking:,} of them the "
        f"whole plant lacked. {virtual.shortfalls[0].unavoidable_percent:.3f} % of the desired "
        "energy was out of reach of any controller."
    )


def _orders(study: _Study) -> str:
    """Say whether the order of help matters."""
    found = "; ".join(
        f"{name} " + ", ".join(f"{one.control_caused_percent:.4f}" for one in worth.shortfalls)
        for name, worth in study.orders.items()
    )
    return f"Order of help in the virtual clusters, control-caused % as above: {found}."


def _search(search: ClusterSearch) -> str:
    found = search.correlation_of_starts
    return (
        f"Search for virtual clusters: {search.starts_at_best} of {len(found)} starts came to the "
        f"best, correlation {min(found):.4f}; median {median(found):.4f}, worst {max(found):.4f}."
    )


def _members(ways: dict[str, list[ClustersWorth]]) -> list[str]:
    """List the clusters that were chosen for a reason."""
    return [
        f"{name}: " + "; ".join(" ".join(cluster) for cluster in worths[0].clusters)
        for name, worths in ways.items()
        if len(worths) == 1
    ]


def _document(study: _Study) -> dict[str, Any]:
    """Return all figures for other programs."""
    return {
        "title": study.title,
        "remarks": study.remarks,
        "ways": [
            _row(study, worth, {"clusters": name, "seed": seed if name == "random" else None})
            for name, worths in study.ways.items()
            for seed, worth in enumerate(worths, start=1)
        ],
        "orders": [_row(study, worth, {"order": name}) for name, worth in study.orders.items()],
        "search": study.search,
    }


def _row(study: _Study, worth: ClustersWorth, first: dict[str, object]) -> dict[str, object]:
    """Return all figures of a run for other programs."""
    return {
        **first,
        "members": worth.clusters,
        "past_correlation": worth.past_correlation,
        "run_correlation": worth.run_correlation,
        "help": worth.help,
        "central_percent": worth.help.plant.central_percent,
        "central_percent_if_plant_sufficient": worth.help.plant_sufficient.central_percent,
        "shortfalls": [
            {"central_period_s": period_s, **asdict(shortfall)}
            for period_s, shortfall in zip(study.periods_s, worth.shortfalls, strict=True)
        ],
    }
