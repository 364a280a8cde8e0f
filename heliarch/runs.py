"""Simulations and comparisons from Python."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import partial
from pathlib import Path
from typing import NamedTuple, get_args

import pandas as pd
from rich.console import Console

from agents.settings import Actuator, Scheme
from bus_schemas.errors import InputError
from launch_scripts.commands.run import run
from launch_scripts.launcher.run_folder import RunRequest
from launch_scripts.launcher.summary import RunSummary
from launch_scripts.scenarios.run_options import RunOptions
from launch_scripts.scenarios.scenario import ScenarioFile, load_scenario
from launch_scripts.scenarios.toml_text import toml_value
from studies.arrays.schemes import SCHEMES
from studies.compare.cases import cases, parse_setting, with_settings
from studies.compare.results import json_rows
from studies.compare.runs import read_two_runs, two_runs_tables
from studies.compare.study import Comparison, run_case
from studies.tables import json_rows as table_rows
from studies.workers import share_work


@dataclass(frozen=True, slots=True)
class SimulatedRun:
    """A run that is over: its figures and counts as in `summary.json`, and a folder to open."""

    summary: RunSummary
    folder: Path


def simulate(
    scenario: str | ScenarioFile = "oahu",
    *,
    start: str | None = None,
    end: str | None = None,
    duration: str | None = None,
    seed: int | None = None,
    scheme: Scheme | None = None,
    actuator: Actuator | None = None,
    settings: Mapping[str, object] | None = None,
    faults: Sequence[str] = (),
    out: str | Path | None = None,
) -> SimulatedRun:
    """Simulate a plant in this process and record it, as `heliarch simulate` does.

    Parameters
    ----------
    scenario
        A shipped scenario, the path of a TOML file, or what `load_scenario` returned.
    start, end
        Local time of the first cycle, and at which the last one ends: `12:30`, or
        `2010-04-01T12:30`.
    duration
        Simulated time in place of `end`: `90s`, `15m`, `1h30m`.
    seed
        Of the synthetic clouds.
    scheme, actuator
        In place of those of the scenario.
    settings
        Fields of the scenario to change: `{"commitment.share": 0.5}`.
    faults
        Rules as for `--fault`: `"source=c1/*,delay=50ms"`.
    out
        Folder of the run; by default a new one in `runs/`.
    """
    _check_names("scheme", () if scheme is None else (scheme,), get_args(Scheme))
    _check_names("actuator", () if actuator is None else (actuator,), get_args(Actuator))
    options = RunOptions(start, duration, end, seed, scheme, actuator, list(faults))
    single = {field: [value] for field, value in (settings or {}).items()}
    scenario_file = with_settings(_loaded(scenario), _texts(single))
    request = RunRequest(scenario_file, options, None if out is None else Path(out))
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        summary, folder = run(request, Console(file=nowhere), time.monotonic())
    folder.write_summary(summary.as_json())
    return SimulatedRun(summary, folder.path)


def compare(
    scenario: str | ScenarioFile = "oahu-day",
    *,
    schemes: Iterable[str] = tuple(SCHEMES),
    actuators: Iterable[Actuator] = (),
    start: str | None = None,
    end: str | None = None,
    duration: str | None = None,
    days: Iterable[date] = (),
    seeds: Iterable[int] = (),
    settings: Mapping[str, object | Sequence[object]] | None = None,
    workers: int = 1,
) -> pd.DataFrame:
    """Compare control schemes, as `heliarch compare` does.

    Parameters
    ----------
    scenario, start, end, duration
        As for `simulate`.
    schemes
        Control schemes; see `heliarch compare --help`.
    actuators
        Each scheme is run with all of these; by default with that of the scenario.
    days, seeds
        Run every day, and every seed of the clouds.
    settings
        Fields of the scenario, each with a value or a list of values:
        `{"commitment.share": [0.3, 0.45]}`. Every combination is a case.
    workers
        Processes that share the cases. With more than one, call this from a script that guards
        its entry point with `if __name__ == "__main__"`.

    Returns
    -------
    DataFrame
        A row for each case, scheme and actuator, a column for each figure of merit.
    """
    comparison = Comparison(tuple(schemes), actuators=tuple(actuators))
    _check_names("schemes", comparison.schemes, tuple(SCHEMES))
    _check_names("actuators", comparison.actuators, get_args(Actuator))
    found = cases(
        _loaded(scenario),
        RunOptions(start, duration, end),
        [parse_setting(text) for text in _texts(settings)],
        tuple(days),
        tuple(seeds),
    )
    table = pd.DataFrame(json_rows(share_work(partial(run_case, comparison), found, workers)))
    return table.drop(columns=["metrics", "remarks"])


class ComparedRuns(NamedTuple):
    """Two recorded runs, A and B, side by side.

    `figures` has a row for each figure of merit: `figure`, `unit`, `A`, `B` and `difference`, B
    less A. `differences` has a row for each message that differs: where it first does, the values
    there, and in how many cycles. Without rows both runs are the same, bit for bit.
    """

    figures: pd.DataFrame
    differences: pd.DataFrame
    notes: tuple[str, ...]


def compare_runs(first: str | Path, second: str | Path) -> ComparedRuns:
    """Compare two recordings, as `heliarch compare RUN RUN` does.

    A and B are the folders of two runs of the same plant that begin at the same time, or their
    `run.mcap`. Of the longer one only the cycles that both have count.
    """
    series, notes = read_two_runs((Path(first), Path(second)))
    tables = two_runs_tables(*series)
    figures, differences = (
        pd.DataFrame(table_rows(table), columns=table.names()) for table in tables
    )
    return ComparedRuns(figures, differences, tuple(notes))


def _check_names(where: str, names: Iterable[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            raise InputError(f"{where}: expected {', '.join(known)}, got {name}")


def _loaded(scenario: str | ScenarioFile) -> ScenarioFile:
    return load_scenario(scenario) if isinstance(scenario, str) else scenario


def _texts(settings: Mapping[str, object] | None) -> list[str]:
    """Return settings as the command line has them."""
    return [
        f"{field}={','.join(map(toml_value, value if isinstance(value, list) else [value]))}"
        for field, value in (settings or {}).items()
    ]
