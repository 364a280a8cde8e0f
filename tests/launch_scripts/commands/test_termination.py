"""SIGTERM and SIGHUP end a measurement as Ctrl-C does, once, and change the exit status."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from launch_scripts.commands.termination import terminable
from launch_scripts.launcher.interruption import interruptible


@contextmanager
def handled(signum: int, handler: signal.Handlers) -> Iterator[None]:
    """The handling of a signal as a shell may have left it."""
    before = signal.signal(signum, handler)
    try:
        yield
    finally:
        signal.signal(signum, before)


@pytest.mark.parametrize(("signum", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_run_is_asked_to_end_once_however_often_the_signal_comes(
    signum: signal.Signals, status: int
) -> None:
    with terminable() as termination:
        with interruptible() as interruption:
            signal.raise_signal(signum)
            signal.raise_signal(signum)  # As `timeout` does.
            assert interruption.count == 1
        assert termination.status(130) == status


def test_ctrl_c_still_counts_beside_it() -> None:
    with terminable() as termination, interruptible() as interruption:
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        assert interruption.count == 2
    assert termination.status(130) == 143


def test_outside_a_run_it_is_a_keyboard_interrupt() -> None:
    with terminable() as termination:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        assert termination.status(130) == 143


def test_so_it_is_in_a_background_job_that_ignores_ctrl_c() -> None:
    with (
        handled(signal.SIGINT, signal.SIG_IGN),
        terminable(),
        pytest.raises(KeyboardInterrupt),
    ):
        signal.raise_signal(signal.SIGTERM)


@pytest.mark.parametrize(
    ("signum", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)]
)
def test_what_is_being_written_is_written_to_its_end(signum: signal.Signals, status: int) -> None:
    with terminable() as termination:
        with termination.held():
            signal.raise_signal(signum)
        assert termination.status(0) == status
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_a_second_ctrl_c_ends_what_is_being_written() -> None:
    with terminable() as termination:
        with termination.held():
            signal.raise_signal(signal.SIGINT)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        assert termination.status(0) == 130


def test_ctrl_c_stays_ignored_while_a_background_job_writes() -> None:
    with handled(signal.SIGINT, signal.SIG_IGN), terminable() as termination:
        with termination.held():
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)
        assert termination.status(0) == 0


def test_without_a_signal_the_status_is_what_it_was() -> None:
    with terminable() as termination:
        assert termination.status(1) == 1


def test_what_nohup_ignores_stays_ignored() -> None:
    with handled(signal.SIGHUP, signal.SIG_IGN), terminable() as termination:
        signal.raise_signal(signal.SIGHUP)
        assert termination.status(0) == 0


def test_afterwards_everything_is_as_before() -> None:
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGHUP)
    with terminable(), interruptible():
        pass
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGHUP)) == before


def test_a_run_of_another_command_leaves_on_sigterm() -> None:
    with pytest.raises(SystemExit) as left, interruptible():
        signal.raise_signal(signal.SIGTERM)
    assert left.value.code == 143
