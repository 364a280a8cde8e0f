"""The barrier before cycle 0: arming rounds get longer, and who holds one up is named."""

from __future__ import annotations

from bus_schemas.signals import COMMAND
from sim_plant.plant_run import needed_messages

COMMANDS = [COMMAND.of(f"c1/inv{number:02d}") for number in range(1, 18)]


def test_an_external_agent_that_is_silent_is_named_and_nobody_else() -> None:
    assert needed_messages(COMMANDS, {"c1/inv07"}) == "c1/inv07/command"


def test_without_one_the_first_few_are_named_and_the_rest_counted() -> None:
    found = needed_messages(COMMANDS, {"c2"})
    assert found.startswith("c1/inv01/command, c1/inv02/command, c1/inv03/command")
    assert "14" in found
    assert needed_messages(COMMANDS[:2], ()) == "c1/inv01/command, c1/inv02/command"


def test_where_all_commands_are_there_it_is_the_recorder() -> None:
    assert "recorder" in needed_messages((), {"c1/inv07"})
