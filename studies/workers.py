"""Shares the work of a study among processes: of this machine, or of a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.resource_tracker import ensure_running
from typing import Any, Final, TypeVar

from agents.process.machine import die_with_parent
from bus_schemas.errors import FailureError, InputError

Item = TypeVar("Item")
Result = TypeVar("Result")

_ANSWER_S: Final = 10
"""How long the scheduler of a cluster may take to answer."""

_SIGNALS: Final = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}


def share_work(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int,
    done: Callable[[], object] = lambda: None,
    cluster: str = "",
) -> list[Result]:
    """Apply a function to each item; return the results in order. Calls `done` after each item.

    With one worker everything runs in this process. With more, function and items must be
    picklable. Workers never outlive this process, however it ends: they ignore the signals that
    end it, and this process kills them at its end; if it cannot, the kernel does.

    cluster: Address of a Dask scheduler, whose workers do the work instead.

    Raises FailureError: A worker was killed.
    """
    if cluster:
        return _share_over_cluster(function, items, cluster, done)
    if workers == 1 or len(items) <= 1:
        found = []
        for item in items:
            found.append(function(item))
            done()
        return found
    context, created = SpawnContext(), list[SpawnProcess]()

    def create(**given: Any) -> SpawnProcess:
        created.append(SpawnProcess(**given))
        return created[-1]

    vars(context)["Process"] = create  # The pool makes its workers by it: so we know them.
    pool = ProcessPoolExecutor(min(workers, len(items)), context, _begin, (function,))
    # Handlers of signals run in this thread: another starts the workers, so no start is left
    # half-way. The kernel ends workers with the thread that started them, so it stays.
    with ThreadPoolExecutor(1) as starter:
        submission = starter.submit(_submit, pool, items)
        try:
            futures = submission.result()
            for future in as_completed(futures):
                future.result()
                done()
            return [future.result() for future in futures]
        except BrokenProcessPool:
            raise FailureError(
                "a worker was killed, often because memory ran out: try fewer --workers"
            ) from None
        finally:
            wait([submission])
            for worker in created:
                if worker.pid is not None:  # It has started.
                    worker.kill()
            pool.shutdown(cancel_futures=True)


def _submit(pool: ProcessPoolExecutor, items: Sequence[Any]) -> list[Future[Any]]:
    """Submit items from a thread of its own; workers inherit its mask: they obey no signal."""
    ensure_running()  # Its start unblocks signals, so it must come before we block them.
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    return [pool.submit(_apply, item) for item in items]


def _share_over_cluster(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    address: str,
    done: Callable[[], object],
) -> list[Result]:
    """Let a cluster do the work; it drops what is left when this process ends."""
    try:
        from distributed import Client, KilledWorker, as_completed  # noqa: PLC0415 - optional
    except ImportError:
        raise InputError.of("--cluster", "expected Dask: pip install 'heliarch[cluster]'") from None
    try:
        client = Client(address, timeout=_ANSWER_S)
    except (OSError, ValueError):
        raise InputError.of("--cluster", f"no Dask scheduler answers at {address}") from None
    with client:
        futures = client.map(function, items, pure=False)
        try:
            for future in as_completed(futures):
                future.result()
                done()
            results: list[Result] = client.gather(futures)
        except KilledWorker as error:
            raise FailureError(f"workers of the cluster died: {error}") from None
    return results


_OF_WORKER: Final[dict[str, Callable[[Any], Any]]] = {}
"""In a worker: the function that it applies. It may be large, so it is sent once."""


def _begin(function: Callable[[Any], Any]) -> None:
    die_with_parent()
    parent = multiprocessing.parent_process()
    if parent is None or os.getppid() != parent.pid:  # It died before the kernel was asked.
        os._exit(1)
    _OF_WORKER["function"] = function


def _apply(item: object) -> object:
    return _OF_WORKER["function"](item)
