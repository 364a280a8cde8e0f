"""The study of clusters: virtual neighbours compared with other ways to choose clusters."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from math import isnan
from statistics import fmean, median
from typing import Final, Literal, TypeAlias

import msgspec
import pandas as pd

from agents.control.clusters import ClusterSearch, search_clusters
from agents.plan import RunPlan, Scheme
from bus_schemas.errors import InputError
from launch_scripts.scenarios.scenario import ControlTable
from studies.clusters.worth import (
    Arrange,
    ClustersWorth,
    Past,
    in_other_orders,
    past_of,
    worth_of,
)
from studies.tables import Cell, Column, Table, key_column, word_column
from studies.workers import share_work

_PAPER_PERIODS_S: Final = (1.0, 10.0, 60.0)
"""How often the central controller acts: always, and as slow as the paper's two upper tiers."""

_LONGEST_PERIOD: Final = 1e6

_OF_MANY: Final[tuple[Callable[[Sequence[float]], float], ...]] = (fmean, min, max)

Done: TypeAlias = tuple[int, ClustersWorth]
"""Place and result of one way to choose clusters."""

_LEGEND: Final = (
    "Correlation: mean over the pairs that share a cluster, in the past and in the run itself.",
    "To central: share of the cycles with an inverter in need that reach the central controller; "
    "able: of those cycles in which the plant as a whole has what is asked for.",
    "Control-caused: shortfall in % of the desired energy, with the central controller acting "
    "every so many seconds; begun lacking: the part of it in periods that began with the whole "
    "plant lacking power.",
)


@dataclass(frozen=True, slots=True)
class ClusterStudy:
    """The results of one run under different clusters.

    Attributes
    ----------
    periods_s
        Periods of the central controller [s].
    ways
        Results for each way to choose clusters; for `random` one for each seed.
    orders
        Results for each order of help in the virtual clusters.
    search
        How the virtual clusters were found.
    """

    title: str
    periods_s: tuple[float, ...]
    ways: dict[str, list[ClustersWorth]]
    orders: dict[str, ClustersWorth]
    search: ClusterSearch
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ClusterQuestion:
    """What is studied: how inverters are arranged, the scheme, and the central periods [cycles]."""

    arrange: Arrange
    control: ControlTable
    inverters: int
    scheme: Scheme
    periods: tuple[int, ...]
    seeds: int


def study_clusters(
    question: ClusterQuestion,
    remarks: tuple[str, ...],
    workers: int,
    watch: Callable[[Generator[Done], int], Iterator[Done]],
) -> ClusterStudy:
    """Run all ways to choose clusters; `watch` passes their results on, to show progress."""
    scheme, periods, control = question.scheme, question.periods, question.control
    past = past_of(question.arrange, control, question.inverters)
    run = question.arrange(_chosen(control, "correlation"))
    orders = {
        name: worth_of(other, past, scheme, periods) for name, other in in_other_orders(run).items()
    }
    virtual = orders["least alike first"]
    others = _other_ways(control, question.seeds)
    tables = [table for _, table in others]
    done = share_work(partial(_worth, question, past), tables, workers)
    found = dict(watch(done, len(tables)))
    ways: dict[str, list[ClustersWorth]] = {"virtual": [virtual]}
    for place, (name, _) in enumerate(others):
        ways.setdefault(name, []).append(found[place])
    return ClusterStudy(
        title=_title(run.plan, scheme),
        periods_s=tuple(period * run.plan.cycle_ns / 1e9 for period in periods),
        ways=ways,
        orders=orders,
        search=search_clusters(past.correlation, [len(cluster) for cluster in virtual.clusters]),
        remarks=remarks,
    )


def _worth(question: ClusterQuestion, past: Past, control: ControlTable) -> ClustersWorth:
    return worth_of(question.arrange(control), past, question.scheme, question.periods)


def central_periods(text: str | None, plan: RunPlan) -> tuple[int, ...]:
    """Read periods of the central controller in seconds; return them in cycles."""
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
                f"--periods: expected multiples of the cycle, {cycle_s:g} s, such as 10,60, "
                f"got {word}"
            )
        periods.append(period)
    return tuple(periods)


def _in_cycles(period_s: float, cycle_s: float) -> int | None:
    """Return a period in cycles; None if it is no whole number of them, at least one."""
    cycles = period_s / cycle_s
    if not 0.5 < cycles < _LONGEST_PERIOD or abs(cycles - round(cycles)) > 1e-6:
        return None
    return round(cycles)


def _title(plan: RunPlan, scheme: Scheme) -> str:
    start = pd.Timestamp(plan.start_time_ns, tz="UTC").tz_convert(plan.timezone)
    return (
        f"{plan.plant} from {start:%Y-%m-%d %H:%M:%S %Z}, {plan.cycles:,} cycles of "
        f"{plan.cycle_ns / 1e9:g} s, scheme {scheme}, actuator {plan.actuator}"
    )


def _chosen(
    control: ControlTable, way: Literal["correlation", "geographic", "random", "most-alike"]
) -> ControlTable:
    return msgspec.structs.replace(control, clusters=way)


def _other_ways(control: ControlTable, seeds: int) -> list[tuple[str, ControlTable]]:
    """Return name and control table of each way to choose clusters but by least correlation."""
    random = _chosen(control, "random")
    return [
        ("geographic", _chosen(control, "geographic")),
        *(
            ("random", msgspec.structs.replace(random, clusters_seed=seed))
            for seed in range(1, seeds + 1)
        ),
        ("most alike", _chosen(control, "most-alike")),
    ]


def clusters_table(study: ClusterStudy) -> Table:
    """Return a row for each way to choose clusters; for random ones mean, least and most."""
    columns = (
        key_column("clusters"),
        Column("correlation, past"),
        Column("correlation, run"),
        Column("to central, all", "%", 1),
        Column("to central, able", "%", 1),
        *(Column("control-caused", f"% at {period_s:g} s") for period_s in study.periods_s),
        Column("begun lacking", f"% at {study.periods_s[-1]:g} s"),
    )
    rows: list[tuple[Cell, ...]] = []
    for name, worths in study.ways.items():
        figures = list(zip(*map(_figures, worths), strict=True))
        names = (
            [name] if len(worths) == 1 else [f"{name}, mean of {len(worths)}", "- least", "- most"]
        )
        for label, of_many in zip(names, _OF_MANY, strict=False):
            known = [[one for one in column if one is not None] for column in figures]
            rows.append((label, *(of_many(column) if column else None for column in known)))
    return Table(study.title, columns, tuple(rows), _LEGEND)


def _figures(worth: ClustersWorth) -> tuple[float | None, ...]:
    """Return the figures of a row of the table."""
    figures = (
        worth.past_correlation,
        worth.run_correlation,
        worth.help.plant.central_percent,
        worth.help.plant_sufficient.central_percent,
        *(shortfall.control_caused_percent for shortfall in worth.shortfalls),
        worth.shortfalls[-1].begun_lacking_percent,
    )
    return tuple(None if value is None or isnan(value) else value for value in figures)


def orders_table(study: ClusterStudy) -> Table:
    """Return the control-caused shortfall of each order of help in the virtual clusters."""
    return Table(
        "Order of help in the virtual clusters",
        (
            key_column("order"),
            *(Column("control-caused", f"% at {period_s:g} s", 4) for period_s in study.periods_s),
        ),
        tuple(
            (name, *(shortfall.control_caused_percent for shortfall in worth.shortfalls))
            for name, worth in study.orders.items()
        ),
    )


def members_table(study: ClusterStudy) -> Table:
    """Return the inverters of each cluster, for ways that choose the same ones each time."""
    rows = [
        (name, "; ".join(" ".join(cluster) for cluster in worths[0].clusters))
        for name, worths in study.ways.items()
        if len(worths) == 1
    ]
    return Table("Members", (key_column("clusters"), word_column("inverters")), tuple(rows))


def study_lines(study: ClusterStudy) -> list[str]:
    """Say what is the same however clusters are chosen, and how virtual ones were found."""
    (virtual,) = study.ways["virtual"]
    needy, cycles = virtual.help.plant.needy, virtual.help.cycles
    lacking = needy - virtual.help.plant_sufficient.needy
    found = study.search.correlation_of_starts
    return [
        f"An inverter was in need in {needy:,} of {cycles:,} cycles; in {lacking:,} of them the "
        f"whole plant lacked power. {virtual.shortfalls[0].unavoidable_percent:.3f} % of the "
        "desired energy was out of reach of any controller.",
        f"Search for virtual clusters: {study.search.starts_at_best} of {len(found)} starts found "
        f"the best, correlation {min(found):.4f}; median {median(found):.4f}, worst "
        f"{max(found):.4f}.",
    ]


def study_json(study: ClusterStudy) -> dict[str, object]:
    """Return all figures of the study for other programs."""
    return {
        "title": study.title,
        "remarks": study.remarks,
        "ways": [
            {
                "clusters": name,
                "seed": seed if name == "random" else None,
                **_json_row(study.periods_s, worth),
            }
            for name, worths in study.ways.items()
            for seed, worth in enumerate(worths, start=1)
        ],
        "orders": [
            {"order": name, **_json_row(study.periods_s, worth)}
            for name, worth in study.orders.items()
        ],
        "search": study.search,
    }


def _json_row(periods_s: Sequence[float], worth: ClustersWorth) -> dict[str, object]:
    return {
        "members": worth.clusters,
        "past_correlation": worth.past_correlation,
        "run_correlation": worth.run_correlation,
        "help": worth.help,
        "central_percent": worth.help.plant.central_percent,
        "central_percent_if_plant_sufficient": worth.help.plant_sufficient.central_percent,
        "shortfalls": [
            {"central_period_s": period_s, **asdict(shortfall)}
            for period_s, shortfall in zip(periods_s, worth.shortfalls, strict=True)
        ],
    }
