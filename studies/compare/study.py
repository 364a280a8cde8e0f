"""Runs the cases of a study: in this process, over several, or over a Dask cluster."""

from __future__ import annotations

import dataclasses
import multiprocessing
import signal
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from typing import Any, Protocol, cast, get_args

from msgspec.structs import replace

from agents.plan import Scheme
from bus_schemas.errors import InputError
from launch_scripts.launcher.simulation import MemoryRun
from launch_scripts.scenarios.preparation import Preparation, prepare
from recordings.read.series import RunSeries, SeriesCollector
from studies.arrays.closed_loop import is_corrected
from studies.arrays.schemes import ReferenceGroups, run_scheme
from studies.compare.cases import Case
from studies.metrics import RunMetrics, run_metrics


@dataclass(frozen=True, slots=True)
class SchemeResult:
    """Figures of merit of one scheme in one case."""

    scheme: str
    metrics: RunMetrics


@dataclass(frozen=True, slots=True)
class CaseResult:
    """What the schemes came to in one case.

    Attributes
    ----------
    label
        Of the case.
    schemes
        In the order asked for. Of grouping control the best, the median and the worst reference
        group by control-caused shortfall.
    prepare_s, run_s
        Time that it took to work out sky and market, and to run all schemes [s].
    remarks
        What was mended in the data, or known only in hindsight.
    """

    label: str
    schemes: tuple[SchemeResult, ...]
    prepare_s: float
    run_s: float
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Comparison:
    """What is compared.

    Attributes
    ----------
    schemes
        Names of `SCHEMES`.
    groups
        Reference groups of grouping control.
    through_agents
        Whether `paper` and `predictive` run through the agents in memory, message by message, and
        not over arrays. The result is the same; it takes a hundred times longer.
    """

    schemes: tuple[str, ...]
    groups: ReferenceGroups = field(default_factory=ReferenceGroups)
    through_agents: bool = False


class WorkerLost(Exception):  # noqa: N818 - it is what happened, not an error of the study
    """A process that worked on the cases is gone."""


def run_case(case: Case, comparison: Comparison) -> CaseResult:
    """Run the schemes on one case.

    Raises
    ------
    InputError
        The case does not fit its data, or a scheme does not fit the plant.
    """
    began = time.perf_counter()
    try:
        preparation = prepare(case.scenario, case.options, "study")
        prepared = time.perf_counter()
        found = tuple(
            SchemeResult(label, metrics)
            for label, metrics, _ in results_of(preparation, comparison)
        )
    except InputError as error:
        raise InputError(f"{case.label}: {error}" if case.label else str(error)) from None
    done = time.perf_counter()
    return CaseResult(case.label, found, prepared - began, done - prepared, remarks_of(preparation))


def results_of(
    preparation: Preparation, comparison: Comparison
) -> Iterator[tuple[str, RunMetrics, RunSeries]]:
    """Yield label, figures of merit and series of each scheme of a prepared run."""
    plan, profile = preparation.plan, preparation.profile
    for name in comparison.schemes:
        if comparison.through_agents and name in get_args(Scheme):
            series = [run_agents(cast(Scheme, name), preparation)]
        else:
            series = run_scheme(name, plan, profile, plan.actuator, comparison.groups)
        metrics = [run_metrics(one) for one in series]
        if len(series) == 1:
            yield name, metrics[0], series[0]
            continue
        order = sorted(
            range(len(series)), key=lambda place: metrics[place].commitment.control_caused_kwh
        )
        for word, place in (
            ("best", order[0]),
            ("median", order[len(order) // 2]),
            ("worst", order[-1]),
        ):
            label = f"{name} {word}"
            yield label, metrics[place], dataclasses.replace(series[place], label=label)


def run_agents(scheme: Scheme, preparation: Preparation) -> RunSeries:
    """Run a hierarchical scheme through the agents in memory, all messages in between."""
    changes: dict[str, Any] = {"scheme": scheme}
    if "correction" in preparation.plan.__struct_fields__:
        changes["correction"] = is_corrected(preparation.plan, scheme)
    plan = replace(preparation.plan, **changes)
    collector = SeriesCollector(plan)
    for _ in MemoryRun(plan, preparation.profile, collector.see).cycles():
        pass
    return collector.series(scheme)


def remarks_of(preparation: Preparation) -> tuple[str, ...]:
    """Return what was mended in the data or known only in hindsight."""
    if not preparation.hindsight:
        return preparation.remarks
    hindsight = "Clusters and neighbours were chosen from the run's own data: hindsight."
    return (*preparation.remarks, hindsight)


def run_cases(
    cases: Sequence[Case],
    comparison: Comparison,
    *,
    workers: int = 1,
    scheduler: str | None = None,
) -> Iterator[tuple[int, CaseResult]]:
    """Run many cases; yield the number and result of each as it is done.

    Parameters
    ----------
    cases, comparison
        What to run.
    workers
        Processes of this machine.
    scheduler
        Address of a Dask scheduler; its workers are used in place of this machine's processes.
        They must have Heliarch installed and see the data under the same paths.

    Raises
    ------
    InputError
        As in `run_case`; the scheduler cannot be reached, or Dask is not installed.
    """
    if scheduler is not None:
        yield from _on_cluster(cases, comparison, scheduler)
    elif workers == 1:
        for number, case in enumerate(cases):
            yield number, run_case(case, comparison)
    else:
        yield from _over_processes(cases, comparison, workers)


def _over_processes(
    cases: Sequence[Case], comparison: Comparison, workers: int
) -> Iterator[tuple[int, CaseResult]]:
    # Ctrl-C reaches every process of a terminal: workers then just end.
    pool = ProcessPoolExecutor(
        workers, initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_DFL)
    )
    try:
        futures = {
            pool.submit(run_case, case, comparison): number for number, case in enumerate(cases)
        }
        yield from _as_completed(futures)
    except BrokenProcessPool:
        raise WorkerLost(
            "a worker was killed, often for a lack of memory: fewer --workers"
        ) from None
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for worker in multiprocessing.active_children():
            worker.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _as_completed(futures: dict[Future[CaseResult], int]) -> Iterator[tuple[int, CaseResult]]:
    open_ones = set(futures)
    while open_ones:
        done, open_ones = wait(open_ones, return_when=FIRST_COMPLETED)
        for future in done:
            yield futures[future], future.result()


def _on_cluster(
    cases: Sequence[Case], comparison: Comparison, scheduler: str
) -> Iterator[tuple[int, CaseResult]]:
    client, as_completed = _dask(scheduler)
    with client:
        futures = {
            client.submit(run_case, case, comparison, pure=False): number
            for number, case in enumerate(cases)
        }
        for future in as_completed(list(futures)):
            yield futures[future], _of_cluster(future, scheduler)


class _Promise(Protocol):
    """A future of Dask's."""

    def result(self) -> CaseResult:
        """Wait for the result."""


def _of_cluster(future: _Promise, scheduler: str) -> CaseResult:
    try:
        return future.result()
    except InputError:
        raise
    except Exception as error:
        # Whatever is wrong with a cluster, it comes as one of many kinds of error.
        reason = f"{type(error).__name__}: {error}".strip(": ")
        raise WorkerLost(f"--scheduler {scheduler}: the cluster gave up ({reason})") from None


def _dask(scheduler: str) -> tuple[Any, Any]:
    try:
        from distributed import Client, as_completed  # noqa: PLC0415
    except ImportError:
        raise InputError(
            "--scheduler needs Dask, which is not installed, accepted is: pip install "
            "'heliarch[cluster]'"
        ) from None
    try:
        client: Any = Client
        return client(scheduler, timeout="10s"), as_completed
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"--scheduler {scheduler}: cannot be reached ({type(error).__name__}), accepted is "
            "the address of a Dask scheduler such as tcp://127.0.0.1:8786"
        ) from None
