"""Keeps a processor busy: `python busy_loop.py CPU BURST PERIOD`, in seconds.

Prints when each burst began and ended [ns of the monotonic clock]; it ends with its input.
"""

from __future__ import annotations

import os
import select
import sys
import time

if __name__ == "__main__":
    burst_ns, period_s = round(float(sys.argv[2]) * 1e9), float(sys.argv[3])
    os.sched_setaffinity(0, {int(sys.argv[1])})
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
    while not select.select([sys.stdin], [], [], period_s - burst_ns / 1e9)[0]:
        began_ns = time.monotonic_ns()
        while time.monotonic_ns() < began_ns + burst_ns:
            pass
        print(began_ns, time.monotonic_ns(), flush=True)
