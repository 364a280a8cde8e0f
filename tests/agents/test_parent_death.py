"""A foreign program does not outlive who started it, even where that is killed."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress

import psutil
import pytest

STARTS_A_SLEEP = """
import os, subprocess, sys
words = [sys.executable, "-P", "-m", "agents.parent_death", str(os.getpid()), "/bin/sleep", "60"]
sleep = subprocess.Popen(words, process_group=0)
print(sleep.pid, flush=True)
sleep.wait()
"""

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="prctl(2) is of Linux")


def test_it_dies_with_its_parent() -> None:
    parent = subprocess.Popen([sys.executable, "-c", STARTS_A_SLEEP], stdout=subprocess.PIPE)
    assert parent.stdout is not None
    sleep = psutil.Process(int(parent.stdout.readline()))
    try:
        while sleep.name() != "sleep":
            os.sched_yield()
        parent.kill()
        parent.wait()
        gone, _ = psutil.wait_procs([sleep], timeout=10.0)
        assert gone == [sleep] or sleep.status() == psutil.STATUS_ZOMBIE
    finally:
        parent.stdout.close()
        with suppress(psutil.NoSuchProcess):
            sleep.kill()


def test_it_does_not_begin_where_the_parent_is_gone_already() -> None:
    words = [sys.executable, "-P", "-m", "agents.parent_death", "1", "/bin/echo", "begun"]
    found = subprocess.run(words, capture_output=True, check=True)
    assert found.stdout == b""
