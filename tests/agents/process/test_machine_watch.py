"""A process that only sleeps sees when the machine stood still."""

from __future__ import annotations

import os
import signal
import time

import psutil

from agents.process.machine_watch import MachineWatch

SLEEPS = 300


def test_a_time_in_which_the_watch_was_not_woken_is_a_stop_of_the_machine() -> None:
    with MachineWatch() as watch:
        process = psutil.Process(watch.process.pid)
        while process.num_ctx_switches().voluntary < SLEEPS:  # It does not sleep yet.
            time.sleep(0.01)
        began_ns = time.monotonic_ns()
        os.kill(process.pid, signal.SIGSTOP)
        time.sleep(0.2)
        os.kill(process.pid, signal.SIGCONT)
        longest = max(watch.stops(), key=lambda one: one.length_ms)
    assert longest.length_ms > 150.0
    assert longest.began_ns < began_ns + 200_000_000 < longest.ended_ns + 50_000_000
