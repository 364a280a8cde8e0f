"""Measures the tables of the documents: `make results DATA=FOLDER PAGES=delays.md`.

    python docs/measured.py [DATA] [PAGE...]

Each table stands between `<!-- measured: NAME -->` and `<!-- end -->`. DATA holds the measurements
in folders of their own; without it, tables that rest on them stay as they are. With pages, such as
clusters.md, only theirs are measured.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

import pandas as pd

from heliarch import compare, load_scenario
from scenarios.scenario import ScenarioFile

DOCUMENTS: Final = Path(__file__).parent
WORKERS: Final = 2
BOTH: Final = ("fraction", "limit")
HIERARCHICAL: Final = ("paper", "predictive")

Lines = Iterator[str]
Columns = Mapping[str, tuple[str, int | None]]
"""Title of each column of a table, and the decimals of its numbers; None for words."""

CASE: Final[Columns] = {"scheme": ("scheme", None), "actuator": ("actuator", None)}
COMMITMENT: Final[Columns] = {
    "satisfied": ("satisfied %", 2),
    "shortfall-energy": ("unsatisfied kWh", 1),
    "unavoidable": ("unavoidable %", 3),
    "control-caused": ("control-caused %", 3),
    "over-delivered": ("over-delivered %", 2),
    "mileage": ("mileage kW/h", 0),
    "rmse": ("RMSE kW", 1),
}
REGULATION: Final[Columns] = {
    "regd-strict": ("fulfilled to 0.1 %", 2),
    "regd": ("to 1 %", 2),
    "regd-feasible-strict": ("of the feasible, to 0.1 %", 2),
    "regd-feasible": ("to 1 %", 2),
    "score": ("PJM score", 3),
    "score-unclipped": ("not clipped", 3),
}


def row(cells: Iterable[object]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def header(titles: Sequence[str]) -> Lines:
    yield row(titles)
    yield "|" + "---|" * len(titles)


def table(rows: pd.DataFrame, columns: Columns) -> Lines:
    """Write these columns of a comparison."""
    yield from header([title for title, _ in columns.values()])
    for _, entry in rows.fillna({"actuator": "-"}).iterrows():
        yield row(
            entry[name] if decimals is None else f"{entry[name]:,.{decimals}f}"
            for name, (_, decimals) in columns.items()
        )


def only(columns: Columns, *names: str) -> Columns:
    return {name: columns[name] for name in names}


# docs/results.md


@cache
def case_study() -> pd.DataFrame:
    return compare("oahu-day", actuators=BOTH)


def headroom() -> Lines:
    shares = {"commitment.share": [0.9, 0.8, 0.7]}
    schemes = ("grouping", *HIERARCHICAL, "physical-limit")
    rows = compare(
        "oahu-day", schemes=schemes, actuators=["fraction"], settings=shares, workers=WORKERS
    )
    energies = only(COMMITMENT, "satisfied", "control-caused", "over-delivered")
    return table(
        rows,
        {
            "commitment.share": ("commitment", None),
            **CASE,
            "ancillary-potential": ("potential kWh", 0),
            **energies,
            "regd-feasible": ("RegD of the feasible, to 1 %", 2),
        },
    )


def skies() -> Lines:
    """Write means over a hundred skies."""
    schemes = ("uniform-cap", "grouping", *HIERARCHICAL)
    rows = compare("oahu", schemes=schemes, actuators=BOTH, seeds=range(1, 101), workers=WORKERS)
    yield from header(["scheme", "actuator", "control-caused %", "5 to 95 %", "over-delivered %"])
    for names, group in rows.groupby(["scheme", "actuator"], sort=False):
        missing, beyond = group["control-caused"], group["over-delivered"]
        spread = f"{missing.quantile(0.05):.3f} to {missing.quantile(0.95):.3f}"
        yield row([*names, f"{missing.mean():.3f}", spread, f"{beyond.mean():.2f}"])


def cycle_lengths() -> Lines:
    rows = compare(
        "oahu",
        schemes=HIERARCHICAL,
        actuators=BOTH,
        settings={"time.cycle_s": [1, 10, 60], "plant.meter_noise": [0, 0.005]},
        workers=WORKERS,
    )
    settings: Columns = {"time.cycle_s": ("cycle [s]", None), "plant.meter_noise": ("noise", None)}
    figures = only(COMMITMENT, "control-caused", "over-delivered", "rmse")
    return table(rows, {**settings, **CASE, **figures})


def hope(data: Path) -> ScenarioFile:
    return load_scenario("hope-melpitz", data / "hope-melpitz-1s")


def real_plant(data: Path) -> ScenarioFile:
    return load_scenario("plant20mw", data / "plant20mw-combiners-10s")


def hour(letter: str) -> dict[str, Any]:
    return {"irradiance.currents": f"hour_{letter}.csv"}


def hours(data: Path) -> Lines:
    settings = {"irradiance.currents": [f"hour_{letter}.csv" for letter in "abc"]}
    rows = compare(real_plant(data), actuators=BOTH, settings=settings)
    return table(rows, {"irradiance.currents": ("file", None), **CASE, **COMMITMENT})


def estimators(scenario: ScenarioFile, settings: Mapping[str, Any]) -> Lines:
    """Write control-caused and over-delivered of each scheme by share, without and with noise."""
    shares = [0.5, 0.7, 0.8, 0.9]
    rows = compare(
        scenario,
        schemes=("uniform-cap", "grouping", *HIERARCHICAL),
        actuators=BOTH,
        settings={"commitment.share": shares, "plant.meter_noise": [0, 0.005], **settings},
        workers=WORKERS,
    )
    yield from header(["actuator", "scheme", *(f"{share:.0%}" for share in shares)])
    rows = rows[rows["scheme"] != "grouping worst"]
    keys = ["actuator", "plant.meter_noise"]
    groups = rows.sort_values(keys, kind="stable").groupby([*keys, "scheme"], sort=False)
    for (actuator, noise, scheme), group in groups:
        pairs = zip(group["control-caused"], group["over-delivered"], strict=True)
        cells = (f"{missing:.3f} ({beyond:.2f})" for missing, beyond in pairs)
        yield row([actuator, f"{scheme}, noise" if noise else scheme, *cells])


# docs/clusters.md


def clusterings(name: str, scenario: str | ScenarioFile, settings: dict[str, Any]) -> pd.DataFrame:
    """Compare ways to choose clusters while the central controller acts every 1, 10 and 60 s."""
    loaded = load_scenario(scenario) if isinstance(scenario, str) else scenario
    cycle_s = loaded.scenario.time.cycle_s
    periods = [round(period_s / cycle_s) for period_s in (1, 10, 60) if period_s >= cycle_s]
    run = partial(compare, loaded, schemes=["predictive"], actuators=["fraction"], workers=WORKERS)
    acting = {"control.period_cycles": [[period, 1] for period in periods], **settings}
    ways = run(settings={"control.clusters": ["correlation", "geographic", "most-alike"], **acting})
    seeds = {"control.clusters": "random", "control.clusters_seed": list(range(1, 21))}
    rows = pd.concat([ways, run(settings=seeds | acting)]).assign(case=name)
    return rows.assign(
        period=[f"{cycles * cycle_s:g} s" for cycles, _ in rows["control.period_cycles"]]
    )


def clusters(cases: Mapping[str, tuple[str | ScenarioFile, dict[str, Any]]]) -> Lines:
    """Write a row for each way to choose clusters, of random ones mean, least and most."""
    tables = [clusterings(name, *case) for name, case in cases.items()]
    periods = list(dict.fromkeys(tables[0]["period"]))
    missed = (f"control-caused %, {period}" for period in periods)
    yield from header(["", "clusters", "help from outside %", "plant able %", *missed])
    for rows in tables:
        for way, group in rows.groupby("control.clusters", sort=False):
            hows = ("mean", "min", "max") if way == "random" else ("mean",)
            for how in hows:
                by_period = group.groupby("period", sort=False)
                always = by_period.get_group(periods[0])
                helped = (always[name].agg(how) for name in ("outside-help", "outside-help-able"))
                caused = by_period["control-caused"].agg(how)
                title = way if way != "random" else f"random, {how} of {len(always)}"
                yield row(
                    [rows["case"].iloc[0], title]
                    + [f"{percent:.1f}" for percent in helped]
                    + [f"{caused[period]:.3f}" for period in periods]
                )


# docs/delays.md

NETWORK: Final[Columns] = {
    "scheme": ("scheme", None),
    "control-caused": ("control-caused %", 3),
    "over-delivered": ("over-delivered %", 3),
    "mileage": ("mileage kW/h", 0),
    "regd": ("RegD to 1 %", 1),
    "score": ("score", 3),
    "missed-inputs": ("inputs missed", 0),
}
FAULT: Final[Columns] = {"fault": ("fault", None)}


def under(**changes: Any) -> pd.DataFrame:
    """Run the hour of that page."""
    settings = {"commitment.share": 0.6, **changes.pop("settings", {})}
    hour_of_clouds = {"start": "12:00", "duration": "1h", "workers": WORKERS}
    return compare("oahu-day", schemes=HIERARCHICAL, settings=settings, **hour_of_clouds, **changes)


def faults(*rules: str) -> Lines:
    return table(under(faults=rules), {**FAULT, **NETWORK})


def central_periods() -> Lines:
    periods = [[cycles, 1] for cycles in (1, 2, 5, 10, 30, 60)]
    rows = under(settings={"control.period_cycles": periods})
    return table(rows, {"control.period_cycles": ("period_cycles", None), **NETWORK})


def longer_cycles() -> Lines:
    rows = pd.concat(
        under(faults=[fault], settings={"time.cycle_s": [1, cycle_s]})
        for fault, cycle_s in (("delay=0.2s", 2), ("delay=0.5s", 5))
    )
    return table(rows, {**FAULT, "time.cycle_s": ("cycle [s]", None), **NETWORK})


def correction() -> Lines:
    rules = ["none", "delay=0.2s", "delay=1s", "loss=20%"]
    rows = under(faults=rules, settings={"control.correction": [True, False]})
    rows = rows[rows["scheme"] == "predictive"]
    rows = rows.sort_values("fault", key=lambda names: names.map(rules.index), kind="stable")
    return table(rows, {**FAULT, "control.correction": ("correction", None), **NETWORK})


Tables = dict[str, Callable[[], Lines]]

SYNTHETIC: Final[dict[str, Tables]] = {
    "results.md": {
        "case study": lambda: table(case_study(), {**CASE, **COMMITMENT}),
        "case study, regulation": lambda: table(case_study(), {**CASE, **REGULATION}),
        "headroom": headroom,
        "skies": skies,
        "cycles": cycle_lengths,
    },
    "clusters.md": {
        "oahu": lambda: clusters({"oahu": ("oahu", {})}),
    },
    "delays.md": {
        "delay": partial(
            faults,
            *("none", "delay=0.1s", "delay=0.2s", "delay=0.5s", "delay=1s", "delay=2s"),
            *("delay=5s", "delay=10s"),
        ),
        "loss": partial(faults, "none", "loss=1%", "loss=5%", "loss=10%", "loss=20%"),
        "period": central_periods,
        "longer cycles": longer_cycles,
        "correction": correction,
    },
}


def measured(data: Path) -> dict[str, Tables]:
    """Return the tables that rest on measurements."""
    plant = real_plant(data)
    return {
        "results.md": {
            "HOPE": lambda: table(compare(hope(data), actuators=BOTH), {**CASE, **COMMITMENT}),
            "HOPE, estimators": lambda: estimators(hope(data), {}),
            **{
                f"hour {letter}, estimators": partial(estimators, plant, hour(letter))
                for letter in "abcde"
                if (data / "plant20mw-combiners-10s" / f"hour_{letter}.csv").exists()
            },
            "hours": partial(hours, data),
        },
        "clusters.md": {
            "HOPE": lambda: clusters({"HOPE": (hope(data), {})}),
            "plant": lambda: clusters({f"hour {name}": (plant, hour(name)) for name in "ac"}),
        },
    }


def write_table(page: str, name: str, lines: Lines) -> None:
    """Write a table into its place in a document."""
    path, text = DOCUMENTS / page, (DOCUMENTS / page).read_text(encoding="utf-8")
    marked = rf"(<!-- measured: {re.escape(name)} -->\n).*?(<!-- end -->)"
    if not re.search(marked, text, re.DOTALL):
        sys.exit(f"{page}: expected a table {name}, got none")
    written = "\n".join(lines)
    # A table has no backslash: it may stand in the replacement.
    path.write_text(re.sub(marked, rf"\g<1>{written}\n\g<2>", text, flags=re.DOTALL), "utf-8")


def main() -> None:
    """Measure the tables, and write each into its document when it is done."""
    pages = [word for word in sys.argv[1:] if word.endswith(".md")] or list(SYNTHETIC)
    data = next((Path(word) for word in sys.argv[1:] if word not in pages), None)
    for page in pages:
        tables = SYNTHETIC[page] | (measured(data)[page] if data and page != "delays.md" else {})
        for name, write in tables.items():
            began = time.monotonic()
            write_table(page, name, write())
            print(f"{page}, {name}: {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
