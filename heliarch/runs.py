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

import numpy as np
import pandas as pd
from rich.console import Console

from agents.settings import Actuator, Scheme
from bus_schemas.errors import InputError
from heliarch.cli.run import run
from launch_scripts.run_folder import RunRequest
from results.run_summary import RunSummary
from results.tables import json_rows as table_rows
from results.two_runs import read_two_runs, two_runs_tables
from scenarios.run_options import RunOptions
from scenarios.scenario import ScenarioFile, load_scenario
from scenarios.settings import Setting, with_settings
from studies.arrays.schemes import SCHEMES
from studies.compare.cases import cases
from studies.compare.study import run_case
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
    chosen = [(field, _plain(value)) for field, value in (settings or {}).items()]
    scenario_file = with_settings(_loaded(scenario), chosen)
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
    faults: Iterable[str] = (),
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
    faults
        Rules as for `--fault`, each a case: one, several that act together (`delay=1s;loss=5%`),
        or `none`.
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
        A row for each case, scheme and actuator. Its columns are what cases differ in (fields of
        `settings` by name, `fault`, `day`, `seed`), scheme, actuator, each figure of merit, and
        remarks: what must be known about the data, such as hindsight.
    """
    names, acting = tuple(schemes), tuple(actuators)
    _check_names("schemes", names, tuple(SCHEMES))
    _check_names("actuators", acting, get_args(Actuator))
    listed = cases(
        _loaded(scenario),
        RunOptions(start, duration, end),
        [_setting(field, value) for field, value in (settings or {}).items()],
        tuple(faults),
        tuple(days),
        tuple(seeds),
    )
    results = share_work(partial(run_case, names, acting), listed, workers)
    return pd.DataFrame([row for rows in results for row in rows])


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


def _setting(field: str, value: object) -> Setting:
    values = value if isinstance(value, list) else [value]
    return Setting(field, tuple(map(_plain, values)))


def _plain(value: object) -> object:
    """Return a number of NumPy as Python's."""
    return value.item() if isinstance(value, np.generic) else value
