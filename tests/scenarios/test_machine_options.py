"""What a run may take of the machine, in the words of the command line."""

from __future__ import annotations

import os

import pytest

from agents.process.machine import MachineSettings
from bus_schemas.errors import InputError
from scenarios.real_time import machine_settings


@pytest.fixture(autouse=True)
def four_cpus(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four processors, of which this process may use all but CPU 2."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1, 3})


def test_processors_are_listed_as_the_kernel_does_and_kinds_may_have_their_own() -> None:
    found = machine_settings(["3,0-1", "plant=3", "direct=1,0"], 20)
    assert found == MachineSettings((0, 1, 3), {"plant": (3,), "direct": (0, 1)}, 20)


@pytest.mark.parametrize(
    "word", ["0-2", "3-1", "inverter=0", "=0", "plant=", "0,", "-1", "all", "0-99999999"]
)
def test_other_words_are_refused(word: str) -> None:
    with pytest.raises(InputError, match=f"^--cpus {word}: expected"):
        machine_settings([word])
