"""The one pool of processes that studies share their work over."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from multiprocessing.resource_tracker import ensure_running
from typing import Any, Final, TypeVar, cast

from agents.process import die_with_parent
from bus_schemas.errors import FailureError, InputError

Item = TypeVar("Item")
Result = TypeVar("Result")

_SIGNALS: Final = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}


class WorkerLostError(FailureError):
    """A process that worked on the study has died."""


def share_work(
    function: Callable[[Item], Result], items: Sequence[Item], workers: int
) -> Generator[tuple[int, Result]]:
    """Apply a function to each item; yield the item's place and the result as each is done.

    With one worker everything runs in this process. With more, function and items must be
    picklable. Workers never outlive this process, however it ends: they ignore the signals that
    end it, this process kills them on its way out, and the kernel does where it cannot.

    Raises WorkerLostError: A worker was killed.
    """
    if workers == 1 or len(items) <= 1:
        yield from enumerate(map(function, items))
        return
    context = multiprocessing.get_context("spawn")
    started: list[SpawnProcess] = []
    ours: list[Connection] = []
    waiting = iter(enumerate(items))
    try:
        ensure_running()  # Its start lifts a block of signals, so it must not fall within ours.
        for _ in range(min(workers, len(items))):
            end, theirs = context.Pipe()
            ours.append(end)
            worker = context.Process(target=_work, args=(theirs,))
            with _signals_blocked(), theirs:
                worker.start()
                started.append(worker)
        for end in ours:
            end.send(function)
            end.send(next(waiting))
        for _ in items:
            end = cast("Connection", wait(ours)[0])
            place, result, error = end.recv()
            if error is not None:
                raise error
            if (item := next(waiting, None)) is not None:
                end.send(item)
            yield place, result
    except (EOFError, ConnectionError):
        raise WorkerLostError(
            "a worker was killed, often because memory ran out: try fewer --workers"
        ) from None
    finally:
        for worker in started:
            worker.kill()
        for worker in started:
            worker.join()


def _work(study: Connection) -> None:
    """Apply the function that the study sends to each of its items, until it kills this process."""
    die_with_parent()
    parent = multiprocessing.parent_process()
    if parent is None or os.getppid() != parent.pid:  # It died before the kernel was asked.
        return
    function = study.recv()
    while True:
        place, item = study.recv()
        try:
            study.send((place, function(item), None))
        except Exception as error:
            study.send((place, None, error))


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
) -> Generator[tuple[int, Result]]:
    """As `share_work`, over the workers of a Dask scheduler.

    They must have Heliarch installed and see the data under the same paths.

    Raises WorkerLostError: The cluster gave up.
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
