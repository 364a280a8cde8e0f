"""The tables of docs/clusters.md."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from functools import cache
from pathlib import Path
from statistics import fmean, median
from typing import Any, Final
from unittest.mock import patch

from msgspec import convert
from tables import WORKERS, Lines, Tables, header, heliarch, hope, plant, row

from agents.control.clusters import ClusterSearch
from agents.cycle import Periods
from heliarch import compare, load_scenario
from launch_scripts.scenarios.scenario import ScenarioFile
from studies.clusters.results import clusters_table
from studies.clusters.study import ClusterStudy, ClustersWorth
from studies.tables import Column, cell_text

PERCENT: Final = Column("", "%", 1)
HOUR_C: Final = "--set irradiance.currents=hour_c.csv"


def cases(data: Path) -> dict[str, str]:
    """Return the command of each measured case, and of its half without hindsight."""
    hope_data = data / "hope-melpitz-1s"
    plant_data = data / "plant20mw-combiners-10s"
    found = {
        "HOPE": f"hope-melpitz --data {hope_data} --random 200",
        "hour a": f"plant20mw --data {plant_data} --random 200",
        "hour c": f"plant20mw --data {plant_data} --random 200 {HOUR_C}",
    }
    for name, learn in (("HOPE", "20m"), ("hour a", "30m"), ("hour c", "30m")):
        found[f"{name}, second half"] = f"{found[name]} --learn {learn}"
    return found


SYNTHETIC: Final = {"oahu": "oahu", "oahu-day": "oahu-day --random 10"}


@cache
def study(words: str) -> ClusterStudy:
    """Return what `heliarch clusters` finds."""
    found = heliarch(f"clusters {words} --workers {WORKERS}")
    ways: dict[str, list[ClustersWorth]] = {}
    for way in found["ways"]:
        ways.setdefault(way["clusters"], []).append(convert(way, ClustersWorth))
    orders = {one["order"]: convert(one, ClustersWorth) for one in found["orders"]}
    return ClusterStudy(found["title"], ways, orders, convert(found["search"], ClusterSearch))


def ways(found: dict[str, str]) -> Lines:
    """Write each way to choose clusters, of each case, as the command prints them."""
    tables = {case: clusters_table(study(words)) for case, words in found.items()}
    first, *_ = tables.values()
    titles = (f"{column.title} {column.unit}".strip() for column in first.columns)
    yield from header(["", *titles])
    for case, table in tables.items():
        yield from (row([case, *texts]) for texts in table.texts())


def missed_percent(worth: ClustersWorth) -> float:
    """Return what control missed with the longest period of the central controller."""
    return worth.shortfalls[-1].control_caused_percent


def measured_ways(*names: str) -> Callable[[Path], Lines]:
    """Return what writes the ways to choose clusters of some measured cases."""
    return lambda data: ways({name: cases(data)[name] for name in names})


def better_than_virtual(data: Path) -> Lines:
    """Write how many random choices do better than the virtual clusters."""
    yield from header(
        ["", "random choices", "call the central controller less", "miss less at 60 s"]
    )
    for case, words in (cases(data) | SYNTHETIC).items():
        of_way = study(words).ways
        virtual, *others = (
            (worth.help.plant.central_percent, missed_percent(worth))
            for worth in (*of_way["virtual"], *of_way["random"])
        )
        counts = [sum(other[at] < virtual[at] for other in others) for at in (0, 1)]
        yield row([case, len(others), *counts])


def orders(data: Path) -> Lines:
    """Write what each order of help misses at 60 s."""
    found = {name: words for name, words in cases(data).items() if "half" not in name} | SYNTHETIC
    studies = {name: study(words) for name, words in found.items()}
    yield from header(["", *studies["HOPE"].orders])
    for name, one in studies.items():
        yield row([name, *(f"{missed_percent(worth):.4f}" for worth in one.orders.values())])


def search(data: Path) -> Lines:
    """Write how the search for virtual clusters ended."""
    yield from header(["", "best", "median", "worst", "starts at the best, of 20"])
    found = {name: words for name, words in cases(data).items() if "half" not in name} | SYNTHETIC
    for name, words in found.items():
        found_by = study(words).search
        starts = found_by.correlation_of_starts
        correlations = [f"{pick(starts):.4f}" for pick in (min, median, max)]
        yield row([name, *correlations, found_by.starts_at_best])


def ten_skies(data: Path) -> Lines:
    """Write the means over ten skies at 60 s."""
    found: dict[str, list[float]] = {}
    for seed in range(1, 11):
        for name, worths in study(f"oahu --random 5 --periods 1,60 --seed {seed}").ways.items():
            found.setdefault(name, []).append(fmean(map(missed_percent, worths)))
    virtual = found["virtual"]
    yield from header(
        ["clusters", "control-caused %, 60 s", "skies on which they miss less than virtual"]
    )
    for name in ("virtual", "geographic", "random"):
        values = found[name]
        less = sum(a < b for a, b in zip(values, virtual, strict=True))
        yield row([name, f"{fmean(values):.3f}", "" if name == "virtual" else less])


# Topping up ---------------------------------------------------------------------------------------


def once_a_minute(data: Path) -> dict[str, tuple[ScenarioFile, dict[str, Any], int]]:
    """Return scenario and settings of each case, and the cycles in a minute."""
    real = plant(data)
    return {
        "HOPE": (hope(data), {}, 60),
        "hour a": (real, {}, 6),
        "hour c": (real, {"irradiance.currents": "hour_c.csv"}, 6),
        "oahu": (load_scenario("oahu"), {}, 60),
        "oahu-day": (load_scenario("oahu-day"), {}, 60),
    }


@cache
def acting(
    data: Path,
    case: str,
    clusters: str = "virtual",
    scheme: str = "predictive",
    tops_up: bool = True,
    always: bool = False,
) -> Any:
    """Return the figures of a run whose central controller acts once a minute, or always."""
    scenario, settings, minute = once_a_minute(data)[case]
    one = {"control.cluster_count": [[1]]} if minute == 6 else {"control.cluster_sizes": [[[17]]]}
    chosen: dict[str, dict[str, Any]] = {
        "virtual": {},
        "geographic": {"control.clusters": "geographic"},
        "one": one,
    }
    period = {"control.period_cycles": [[1 if always else minute, 1]]}
    settings = settings | chosen[clusters] | period
    # So no parent tops up its children between its turns.
    at_rest = patch.object(Periods, "rests_between", return_value=False)
    with nullcontext() if tops_up else at_rest:
        return compare(scenario, schemes=[scheme], settings=settings).iloc[0]


def topping_up(data: Path) -> Lines:
    """Write what topping up saves, by the choice of clusters."""
    columns = {
        **{
            f"{name}, {'topped up' if tops_up else 'not topped up'}": (name, "predictive", tops_up)
            for name in ("one", "virtual", "geographic")
            for tops_up in (False, True)
        },
        "virtual, `paper`": ("virtual", "paper", True),
        "geographic, `paper`": ("geographic", "paper", True),
    }
    yield from header(["", *columns, "virtual, always acting"])
    for case in once_a_minute(data):
        found = [acting(data, case, *what) for what in columns.values()]
        found.append(acting(data, case, always=True))
        yield row([case, *(f"{one['control-caused']:.3f}" for one in found)])


def cost_of_topping_up(data: Path) -> Lines:
    """Write what topping up costs with virtual clusters."""
    figures_of = {"over-delivered": ("over-delivered %", 3), "mileage": ("mileage kW/h", 0)}
    ways_to_act = ("not topped up", "topped up", "always acting", "paper")
    titles = [f"{title}, {way}" for title, _ in figures_of.values() for way in ways_to_act]
    yield from header(["", *titles])
    for case in once_a_minute(data):
        found = [
            acting(data, case, tops_up=False),
            acting(data, case),
            acting(data, case, always=True),
            acting(data, case, scheme="paper"),
        ]
        numbers = [
            f"{one[name]:,.{decimals}f}"
            for name, (_, decimals) in figures_of.items()
            for one in found
        ]
        yield row([case, *numbers])


def by_share(data: Path) -> Lines:
    """Write needy cycles with the paper's scheme on HOPE, by the commitment."""
    yield from header(
        [
            *("commitment, share of median", "needy cycles %"),
            *("to central %, all, virtual / geographic", "able"),
            *("by cluster, all", "by cluster, able"),
        ]
    )
    for share in (0.5, 0.6, 0.7, 0.8, 0.9):
        one = study(
            f"hope-melpitz --data {data / 'hope-melpitz-1s'} --scheme paper --periods 1 --random 1 "
            f"--set commitment.share={share}"
        )
        virtual, geographic = (one.ways[name][0].help for name in ("virtual", "geographic"))
        needy = 100.0 * virtual.plant.needy / virtual.cycles
        pairs = []
        for which in ("plant", "plant_sufficient", "clusters", "clusters_sufficient"):
            percents = (getattr(each, which).central_percent for each in (virtual, geographic))
            pairs.append(" / ".join(cell_text(percent, PERCENT) for percent in percents))
        yield row([share, f"{needy:.1f}", *pairs])


FROM_SYNTHETIC: Final[Tables] = {
    "oahu": lambda data: ways(SYNTHETIC),
    "ten skies": ten_skies,
}
FROM_DATA: Final[Tables] = {
    "HOPE": measured_ways("HOPE", "HOPE, second half"),
    "plant": measured_ways("hour a", "hour c", "hour a, second half", "hour c, second half"),
    "better": better_than_virtual,
    "topping up": topping_up,
    "cost of topping up": cost_of_topping_up,
    "orders": orders,
    "search": search,
    "by share": by_share,
}
