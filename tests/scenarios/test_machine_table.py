"""What a run may take of the machine: words of the command line and of scenarios, checked."""

from __future__ import annotations

import os

import msgspec
import pytest

from agents.process.machine import MachineSettings
from bus_schemas.errors import InputError
from scenarios.real_time import MachineTable, machine_settings


@pytest.fixture(autouse=True)
def four_cpus(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four processors, of which this process may use all but CPU 2."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1, 3})


def settings(
    *cpus: str, priority: int | None = None, lockstep: bool = False, table: str = ""
) -> MachineSettings:
    """Return the settings that options and the table of a scenario lead to."""
    read = msgspec.toml.decode(table.encode(), type=MachineTable)
    return machine_settings(read, "machine.cpus:", cpus, priority, lockstep=lockstep)


def test_processors_are_listed_as_the_kernel_does_and_kinds_may_have_their_own() -> None:
    found = settings("3,0-1", "plant=3", "direct=1,0")
    assert found.cpus == (0, 1, 3)
    assert found.cpus_of == {"plant": (3,), "direct": (0, 1)}


@pytest.mark.parametrize(
    "word", ["0-2", "3-1", "inverter=0", "=0", "plant=", "0,", "-1", "all", "0-99999999"]
)
def test_other_words_are_refused(word: str) -> None:
    with pytest.raises(InputError, match=f"^--cpus {word}: expected"):
        settings(word)


def test_a_priority_needs_a_pace() -> None:
    with pytest.raises(InputError, match="--priority: expected a --pace"):
        settings(priority=20, lockstep=True)


def test_a_scenario_says_the_same_and_the_command_line_goes_before_it() -> None:
    table = 'cpus = ["0-1", "plant=3"]\npriority = 20'
    found = settings(table=table)
    assert found == MachineSettings((0, 1), {"plant": (3,)}, 20)
    assert settings("3", priority=7, table=table) == MachineSettings((3,), {}, 7)
    # A scenario may be run in lockstep too: there its priority is of no use, and of no harm.
    assert settings(table=table, lockstep=True).priority == 20


def test_a_wrong_scenario_names_its_field() -> None:
    with pytest.raises(InputError, match=r"machine\.cpus: 9: expected"):
        settings(table='cpus = ["9"]')
    with pytest.raises(msgspec.ValidationError, match="priority"):
        settings(table="priority = 100")
