"""Ctrl-C does not tear apart what is only starting."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from launch_scripts.launcher.interruption import interruptions_wait
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from studies.delays import study as delay_study

PREPARED = prepare(load_scenario("oahu"), RunOptions(duration="5"), "interrupted")

_INTERRUPT_ONESELF = """
import os, signal
from launch_scripts.launcher.interruption import end_when_interrupted
os.kill(os.getpid(), signal.SIGINT)
print("imported", flush=True)
end_when_interrupted()
print("not reached")
"""


def is_held_back() -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_an_interruption_comes_after_the_block() -> None:
    done: list[bool] = []

    def interrupt_and_go_on() -> None:
        with interruptions_wait():
            signal.raise_signal(signal.SIGINT)
            done.append(is_held_back())

    with pytest.raises(KeyboardInterrupt):
        interrupt_and_go_on()
    assert done == [True]
    assert not is_held_back()


def test_a_process_that_is_started_meanwhile_ends_without_a_word_once_it_has_imported() -> None:
    with interruptions_wait():
        process = subprocess.Popen(
            [sys.executable, "-c", _INTERRUPT_ONESELF],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
    told, complained = process.communicate(timeout=60)
    assert (told, complained) == ("imported\n", "")
    assert process.returncode == -signal.SIGINT


def test_the_workers_of_a_study_are_started_so(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bool] = []
    initializers: list[Callable[[], None]] = []

    class Pool:
        def __init__(self, workers: int, *, initializer: Callable[[], None], **_: object) -> None:
            initializers.append(initializer)

        def submit(self, *_: object) -> int:
            seen.append(is_held_back())
            return len(seen)

        def shutdown(self, *, cancel_futures: bool) -> None:
            assert cancel_futures

    def nothing(_: object) -> Iterator[object]:
        yield from ()

    ready: list[str] = []
    monkeypatch.setattr(delay_study, "die_with_parent", lambda: ready.append("dies with us"))
    monkeypatch.setattr(delay_study, "end_when_interrupted", lambda: ready.append("hears Ctrl-C"))
    monkeypatch.setattr(delay_study, "ProcessPoolExecutor", Pool)
    monkeypatch.setattr(delay_study, "as_completed", nothing)
    chosen = delay_study.conditions(1.0, 3600.0)
    assert list(delay_study.run_study_over(PREPARED.plan, PREPARED.profile, chosen, 2)) == []
    assert seen == [True] * len(chosen)
    assert not is_held_back()
    (begin_worker,) = initializers
    begin_worker()
    assert ready == ["dies with us", "hears Ctrl-C"]


def test_workers_of_a_study_that_did_not_hear_the_signal_are_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ended: list[str] = []

    class Worker:
        def terminate(self) -> None:
            ended.append("worker")

    class Pool:
        def __init__(self, *_: object, **__: object) -> None:
            pass

        def submit(self, *_: object) -> int:
            return 0

        def shutdown(self, *, cancel_futures: bool) -> None:
            assert cancel_futures
            ended.append("pool")

    def interrupted(_: object) -> Iterator[object]:
        raise KeyboardInterrupt

    monkeypatch.setattr(delay_study, "ProcessPoolExecutor", Pool)
    monkeypatch.setattr(delay_study, "as_completed", interrupted)
    monkeypatch.setattr("multiprocessing.active_children", lambda: [Worker()])
    chosen = delay_study.conditions(1.0, 3600.0)
    with pytest.raises(KeyboardInterrupt):
        list(delay_study.run_study_over(PREPARED.plan, PREPARED.profile, chosen, 2))
    assert ended == ["worker", "pool"], "it waits for what has been ended alone"
