"""Runs and comparisons from Python: what the commands do, with the same names and checks."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from datetime import date
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias, TypedDict, TypeVar, Unpack, get_args

import pandas as pd
from rich.console import Console

from agents.settings import Actuator, Scheme
from bus_schemas.errors import InputError, InputWarning
from bus_schemas.selection import find_signals
from heliarch.cli.live_view import PlainView
from heliarch.cli.options import is_run
from heliarch.cli.run import carry_out
from heliarch.recorded import Run, by_parameter, open_run
from launch_scripts.fork_server_process import ForkServer, fork_server
from recordings.export.exporting import ExportSummary, Form
from recordings.export.exporting import export as export_run
from recordings.export.mcap_copies import Clock
from recordings.read.reader import RunReader
from recordings.verify.comparison import Equality
from recordings.verify.verification import Verification
from recordings.verify.verification import verify as verify_run
from results.tables import json_rows
from results.timing.report import TimingReport, report_on
from results.two_runs import diff_runs
from scenarios.run_options import RunOptions, TimeOptions, check_names
from scenarios.scenario import ScenarioFile, load_scenario
from scenarios.settings import Setting, plain, with_settings
from scenarios.times import When
from studies.arrays.schemes import SCHEMES, schemes_for
from studies.compare.cases import cases
from studies.compare.study import run_case
from studies.timing import measured_run, parse_rates, prepare_at
from studies.workers import share_work

T = TypeVar("T")


class TimeKeywords(TypedDict, total=False):
    """Which part of a scenario is run, see `TimeOptions`."""

    start: When | None
    duration: When | None
    end: When | None


class RunKeywords(TimeKeywords, total=False):
    """All that can be asked for of a run, see `RunOptions`."""

    pace: str | float | None
    seed: int | None
    scheme: Scheme | None
    actuator: Actuator | None
    faults: str | Iterable[str] | None
    external: str | Iterable[str] | None
    devices: str | Iterable[str] | None
    operator: str | None
    external_timeout_s: float
    base_port: int | None
    secure: bool
    keys: Path | None
    address: str
    on: str | Iterable[str] | None
    cpus: str | Iterable[str] | None
    priority: int | None
    split: str | None


Recording: TypeAlias = str | Path | Run
"""A recorded run: its folder, its MCAP file, or what `open_run` returned."""

_SEVERAL: Final = ("faults", "external", "devices", "on", "cpus")
"""Options that may be given several times, or as one text."""


@by_parameter
def simulate(
    scenario: str | ScenarioFile = "oahu",
    *,
    settings: Mapping[str, object] | None = None,
    data: str | Path | None = None,
    out: str | Path | None = None,
    **options: Unpack[RunKeywords],
) -> Run:
    """Simulate a plant in this process and record it, as `heliarch simulate` does.

    Parameters
    ----------
    scenario
        A shipped scenario, the path of a TOML file, or what `load_scenario` returned.
    settings
        Fields of the scenario to change: `{"commitment.share": 0.5}`, or tables whose other fields
        stay: `{"commitment": {"share": 0.5}}`.
    data
        Folder of the data files that the scenario names.
    out
        Folder of the run; by default a new one in `runs/`.
    options
        By the names of `RunOptions`, as for the command: `start` and `end` (`"12:30"`, seconds or
        `"c90"`; `end` is no part of the run), `duration` (`"15m"`, or 900 for seconds), `seed`,
        `scheme`, `actuator`, `faults` (`["source=c1/*,delay=50ms"]`), `pace`.
    """
    return _run(_file(scenario, settings, data), options, out)


@by_parameter
def launch(
    scenario: str | ScenarioFile = "oahu",
    *,
    settings: Mapping[str, object] | None = None,
    data: str | Path | None = None,
    out: str | Path | None = None,
    **options: Unpack[RunKeywords],
) -> Run:
    """Run a plant as a team of processes over Zenoh and record it, as `heliarch launch` does.

    Parameters are those of `simulate`. What failed in the run is a warning, as in the command's
    last lines.
    """
    with fork_server() as server:
        return _run(_file(scenario, settings, data), options, out, server)


@by_parameter
def timing(
    scenario: str | ScenarioFile | Run = "oahu",
    *,
    rate: float = 1.0,
    settings: Mapping[str, object] | None = None,
    data: str | Path | None = None,
    out: str | Path | None = None,
    **options: Unpack[RunKeywords],
) -> TimingReport:
    """Run a plant at so many cycles a second and judge it, as `heliarch timing` does.

    Parameters are those of `simulate`. A recorded run in place of the scenario is judged without a
    new one.
    """
    if isinstance(scenario, Run) or (isinstance(scenario, str) and is_run(Path(scenario))):
        return report_on(_path(scenario))
    rate_hz, highest_hz = parse_rates(str(rate))
    if rate_hz != highest_hz:
        raise InputError.of("rate", f"expected one number, got {rate}")
    preparation, folder = prepare_at(
        rate_hz, 60.0, _file(scenario, settings, data), _options(options), _folder(out)
    )
    return measured_run(
        preparation, folder, partial(PlainView, Console(file=StringIO(), force_jupyter=False))
    )


@by_parameter
def verify(
    run: Recording,
    *,
    nodes: str | Sequence[str] = (),
    tolerance: float = 0.0,
) -> Verification:
    """Run the agents of a recording again and compare, as `heliarch verify` does: see `equal`."""
    if not tolerance >= 0.0:
        raise InputError.of("tolerance", f"expected 0 or more, got {tolerance}")
    return verify_run(_path(run), nodes, Equality(tolerance))


@by_parameter
def export(
    run: Recording,
    form: Form,
    *,
    out: str | Path | None = None,
    signals: str | Sequence[str] = (),
    nodes: str | Sequence[str] = (),
    start: When | None = None,
    end: When | None = None,
    clock: Clock | None = None,
    at: When | None = None,
    window_s: float | None = None,
) -> ExportSummary:
    """Make tables, or a file for viewers, from a recording, as `heliarch export` does."""
    check_names("form", (form,), get_args(Form))
    with RunReader(_path(run)) as reader:
        is_whole = start is None and end is None
        cycles = None if is_whole else reader.clock.span(start, end, ("start", "end"))
        parts = find_signals(signals), nodes, cycles, clock, at, window_s
        return export_run(reader, form, _folder(out), *parts)


@by_parameter
def compare(
    scenario: str | ScenarioFile = "oahu-day",
    *,
    schemes: str | Iterable[str] | None = None,
    actuators: Actuator | Iterable[Actuator] = (),
    faults: str | Iterable[str] = (),
    days: date | Iterable[date] = (),
    seeds: int | Iterable[int] = (),
    settings: Mapping[str, object] | None = None,
    data: str | Path | None = None,
    workers: int = 1,
    cluster: str = "",
    **span: Unpack[TimeKeywords],
) -> pd.DataFrame:
    """Compare control schemes, as `heliarch compare` does.

    Parameters
    ----------
    scenario, data
        As for `simulate`.
    schemes
        Control schemes, see `heliarch compare --help`. Default: all; of a fleet, those for plants.
    actuators
        Each scheme is run with all of these; by default with that of the scenario.
    faults
        Rules as for `--fault`, each a case: one, several that act together (`delay=1s;loss=5%`),
        or `none`.
    days, seeds
        Run every day, and every seed of the clouds.
    settings
        Fields of the scenario, each with a value, or with a list, tuple or array of values:
        `{"commitment.share": [0.3, 0.45]}`. Every combination is a case.
    workers
        Processes that share the cases. With more than one, call this from a script that guards
        its entry point with `if __name__ == "__main__"`.
    cluster
        Address of a Dask scheduler, whose workers share the cases instead.
    span
        `start`, `end` or `duration`, as for `simulate`.

    Returns
    -------
    DataFrame
        A row for each case, scheme and actuator. Its columns are what cases differ in (fields of
        `settings` by name, `fault`, `day`, `seed`), scheme, actuator, each figure of merit, and
        remarks: what must be known about the data, such as hindsight.
    """
    file = _loaded(scenario, data)
    names = schemes_for(file.scenario) if schemes is None else _several(schemes)
    acting = _several(actuators)
    check_names("schemes", names, tuple(SCHEMES))
    check_names("actuators", acting, get_args(Actuator))
    check_names("options", span, [field.name for field in fields(TimeOptions)])
    if workers < 1:
        raise InputError.of("workers", f"expected 1 or more, got {workers}")
    listed = cases(
        file,
        RunOptions.of(TimeOptions(**span)),
        [_setting(field, value) for field, value in (settings or {}).items()],
        _several(faults),
        tuple(_read("days", date.fromisoformat, day) for day in _several(days)),
        tuple(_read("seeds", int, seed) for seed in _several(seeds)),
    )
    results = share_work(partial(run_case, names, acting), listed, workers, cluster=cluster)
    return pd.DataFrame([row for rows in results for row in rows])


class Diff(NamedTuple):
    """Two recorded runs, A and B, side by side.

    `scenario` has a row for each setting that differs, `figures` one for each figure of merit:
    `figure`, `unit`, `A`, `B` and `difference`, B less A. `differences` has a row for each signal
    that differs: where it first does, the values there, and in how many cycles. `equal`: all
    messages of both were compared, and are the same.
    """

    scenario: pd.DataFrame
    figures: pd.DataFrame
    differences: pd.DataFrame
    notes: tuple[str, ...]
    equal: bool


@by_parameter
def diff(first: Recording, second: Recording) -> Diff:
    """Compare two recordings, as `heliarch diff` does.

    A and B are two runs of the same plant that begin at the same time. Only the cycles that both
    have recorded count.
    """
    found = diff_runs((_path(first), _path(second)))
    assert found.verdict is not None
    equal, verdict = found.verdict
    scenario, figures, differences = (
        pd.DataFrame(json_rows(one), columns=one.names()) for one in found.tables
    )
    return Diff(scenario, figures, differences, (*found.lines, verdict), equal)


def _run(
    file: ScenarioFile,
    options: Mapping[str, Any],
    out: str | Path | None,
    server: ForkServer | None = None,
) -> Run:
    asked, began_at = _options(options), time.monotonic()
    quiet = Console(file=StringIO(), force_jupyter=False)
    summary, folder = carry_out(file, asked, _folder(out), quiet, began_at, server)
    failures = [*summary.failures()]
    try:
        folder.write_summary(summary.as_json())
    except OSError as error:  # A full disk: the figures are in the recording.
        failures.append(str(error))
    for failure in failures:
        warnings.warn(failure, InputWarning, stacklevel=4)
    return open_run(folder.path)


def _options(options: Mapping[str, Any]) -> RunOptions:
    check_names("options", options, [field.name for field in fields(RunOptions)])
    several = {name: list(_several(options[name])) for name in _SEVERAL if options.get(name)}
    return RunOptions(**{**options, **several})


def _file(
    scenario: str | ScenarioFile, settings: Mapping[str, object] | None, data: str | Path | None
) -> ScenarioFile:
    return with_settings(_loaded(scenario, data), [*(settings or {}).items()])


def _folder(out: str | Path | None) -> Path | None:
    return None if out is None else Path(out)


def _loaded(scenario: str | ScenarioFile, data: str | Path | None) -> ScenarioFile:
    if isinstance(scenario, ScenarioFile):
        return scenario
    return load_scenario(scenario, None if data is None else Path(data))


def _setting(field: str, value: object) -> Setting:
    found = plain(value)
    return Setting(field, tuple(found) if isinstance(found, list | tuple) else (found,))


def _path(run: Recording) -> Path:
    return run.path if isinstance(run, Run) else Path(run)


def _several(given: object) -> tuple[Any, ...]:
    """Return what is given, one or several; a text is one."""
    if isinstance(given, Iterable) and not isinstance(given, str):
        return tuple(given)
    return (given,)


def _read(name: str, read: Callable[[str], T], given: object) -> T:
    try:
        return read(str(given))
    except ValueError as error:
        raise InputError(f"{name}: {error}, got {given!r}") from None
