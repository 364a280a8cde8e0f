"""Work is shared over processes, and none of them outlives the study."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.context import SpawnProcess
from pathlib import Path
from pickle import PicklingError
from signal import SIGINT

import psutil
import pytest
from command_line import process
from work_by_hand import die_on_three, refuse_three, sleep_for

from bus_schemas.errors import FailureError, InputError
from studies.workers import share_work


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_the_work_arrives_as_it_is(workers: int) -> None:
    with pytest.raises(InputError, match="expected no 3"):
        share_work(refuse_three, range(6), workers)


def test_a_worker_that_is_killed_is_reported() -> None:
    with pytest.raises(FailureError, match="killed"):
        share_work(die_on_three, range(6), 2)


def interrupt() -> None:
    raise KeyboardInterrupt


def test_an_interruption_ends_the_workers() -> None:
    large = bytes(1_000_000)
    with pytest.raises(KeyboardInterrupt):
        share_work(sleep_for, [(0.0, large), *((600.0, large),) * 9], 2, interrupt)
    assert not [child for child in psutil.Process().children() if "spawn_main" in words(child)]


class Interrupting:
    """Sleeps. When it is first sent to a worker, Ctrl-C comes."""

    def __init__(self) -> None:
        self.interrupts = True

    def __getstate__(self) -> dict[str, bool]:
        if self.interrupts:
            self.interrupts = False
            os.kill(os.getpid(), SIGINT)
            time.sleep(0.5)  # Python hears of it meanwhile.
        return {"interrupts": False}

    def __call__(self, seconds: float) -> None:
        time.sleep(seconds)


def test_an_interruption_while_workers_start_ends_them() -> None:
    is_over = threading.Event()
    other = threading.Thread(target=is_over.wait)  # The kernel may give the signal to it.
    other.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            share_work(Interrupting(), [1.0] * 9, 2)
    finally:
        is_over.set()
        other.join()
    assert not [child for child in psutil.Process().children() if "spawn_main" in words(child)]


def test_work_that_cannot_be_sent_is_an_error() -> None:
    with pytest.raises((AttributeError, PicklingError), match="local object"):
        share_work(lambda item: item, range(3), 2)


def test_a_child_of_the_program_that_began_meanwhile_is_left_alone() -> None:
    others: list[SpawnProcess] = []

    def begin_another() -> None:
        others.append(SpawnProcess(target=time.sleep, args=(600.0,)))
        others[-1].start()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        share_work(sleep_for, [(0.0, b"")] * 3, 2, begin_another)
    (other,) = others
    assert other.is_alive()
    other.kill()


def words(one: psutil.Process) -> str:
    with suppress(psutil.NoSuchProcess):  # A child that has ended since is no worker.
        return " ".join(one.cmdline())
    return ""


@pytest.fixture
def comparison(tmp_path: Path) -> Iterator[psutil.Process]:
    """`heliarch compare --workers 2`, long enough to be ended by the test."""
    command = "compare oahu-day --seeds 1..50 --schemes uniform-cap --workers 2"
    with process(*command.split(), cwd=tmp_path) as started:
        yield psutil.Process(started.pid)
        started.kill()


@pytest.mark.processes
def test_no_worker_outlives_a_comparison_that_is_killed(comparison: psutil.Process) -> None:
    give_up_at = time.monotonic() + 60.0
    workers: list[psutil.Process] = []
    while len(workers) < 2:
        assert time.monotonic() < give_up_at, "the workers never started"
        workers = [child for child in comparison.children() if "spawn_main" in words(child)]
        time.sleep(0.05)
    comparison.kill()
    _, alive = psutil.wait_procs([*workers, comparison], timeout=30)
    assert not alive
