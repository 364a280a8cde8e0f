"""Ctrl-C and SIGTERM during a run."""

from __future__ import annotations

import signal

import pytest

from agents.process.interruption import interruptible


@pytest.mark.parametrize(("before", "count"), [(signal.SIG_DFL, 1), (signal.SIG_IGN, 0)])
def test_ctrl_c_is_counted_and_where_it_is_ignored_it_stays_ignored(
    before: signal.Handlers, count: int
) -> None:
    outside = signal.signal(signal.SIGINT, before)
    try:
        with interruptible() as interruption:
            signal.raise_signal(signal.SIGINT)
        assert interruption.count == count
        assert signal.getsignal(signal.SIGINT) is before
    finally:
        signal.signal(signal.SIGINT, outside)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_two_signals_in_a_row_as_timeout_sends_them_ask_once(number: signal.Signals) -> None:
    with interruptible() as interruption:
        signal.raise_signal(number)
        signal.raise_signal(number)
    assert interruption.count == 1
