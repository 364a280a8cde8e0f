"""The one pool of processes that studies share their work over."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from importlib import import_module
from multiprocessing.resource_tracker import ensure_running
from typing import Any, Final, TypeVar

from agents.process import die_with_parent
from bus_schemas.errors import FailureError, InputError

Item = TypeVar("Item")
Result = TypeVar("Result")

_SIGNALS: Final = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}


class WorkerLostError(FailureError):
    """A process that worked on the study has died."""


def share_work(
    function: Callable[[Item], Result], items: Sequence[Item], workers: int
) -> Iterator[tuple[int, Result]]:
    """Apply a function to each item; yield the item's place and the result as each is done.

    With one worker everything runs in this process. With more, function and items must be
    picklable. Workers never outlive this process, however it ends: they ignore the signals that
    end it, this process kills them on its way out, and the kernel does where it cannot.

    Raises
    ------
    WorkerLostError
        A worker was killed.
    """
    if workers == 1 or len(items) <= 1:
        yield from enumerate(map(function, items))
        return
    pool = ProcessPoolExecutor(
        min(workers, len(items)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_die_with_study,
    )
    try:
        ensure_running()  # Its start lifts a block of signals, so it must not fall within ours.
        with _signals_blocked():
            places = {pool.submit(function, item): place for place, item in enumerate(items)}
        for future in as_completed(places):
            yield places[future], future.result()
    except BrokenProcessPool:
        raise WorkerLostError(
            "a worker was killed, often because memory ran out: try fewer --workers"
        ) from None
    finally:
        for worker in multiprocessing.active_children():
            worker.kill()
        pool.shutdown(cancel_futures=True)


def _die_with_study() -> None:
    die_with_parent()
    study = multiprocessing.parent_process()
    if study is None or os.getppid() != study.pid:  # It died before the kernel was asked.
        os._exit(1)


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """Start processes that ignore the signals which end this one, from their first import on.

    Ctrl-C and `timeout` send them to every process of a terminal or group; only the study answers.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def share_over_cluster(
    function: Callable[[Item], Result], items: Sequence[Item], scheduler: str
) -> Iterator[tuple[int, Result]]:
    """As `share_work`, over the workers of a Dask scheduler.

    They must have Heliarch installed and see the data under the same paths.

    Raises
    ------
    InputError
        Dask is not installed, or the scheduler cannot be reached.
    WorkerLostError
        The cluster gave up.
    """
    try:
        distributed: Any = import_module("distributed")
    except ImportError:
        raise InputError(
            "--scheduler: Dask is not installed; install it with pip install 'heliarch[cluster]'"
        ) from None
    try:
        client = distributed.Client(scheduler, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            "--scheduler: expected the address of a Dask scheduler such as tcp://127.0.0.1:8786, "
            f"got {scheduler} ({type(error).__name__})"
        ) from None
    with client:
        places = {
            client.submit(function, item, pure=False): place for place, item in enumerate(items)
        }
        for future in distributed.as_completed(list(places)):
            try:
                result: Result = future.result()
            except InputError:
                raise
            except Exception as error:  # Whatever is wrong with a cluster comes in many kinds.
                raise WorkerLostError(
                    f"--scheduler {scheduler} gave up ({type(error).__name__}: {error})"
                ) from None
            yield places[future], result
