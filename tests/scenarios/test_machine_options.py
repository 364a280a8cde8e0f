"""What a run may take of the machine, in the words of the command line."""

from __future__ import annotations

import os

import pytest
from complaints import complaint_of

from agents.process.machine import MachineSettings
from scenarios.real_time import machine_settings


def test_processors_are_listed_as_the_kernel_does_and_kinds_may_have_their_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1, 3})  # All but CPU 2 of four.
    found = machine_settings(["3,0-1", "plant=3", "direct=1,0"], 20)
    assert found == MachineSettings((0, 1, 3), {"plant": (3,), "direct": (0, 1)}, 20)
    for word in ("0-2", "3-1", "inverter=0", "=0", "plant=", "0,", "-1", "all", "0-99999999"):
        assert complaint_of(machine_settings, [word]).startswith(f"--cpus {word}: expected")
