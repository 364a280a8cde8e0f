"""Of an arming round that does not close the plant names who holds it up, not who waits as well."""

from __future__ import annotations

from bus_schemas.signals import COMMAND
from sim_plant.conductor import needed_words

COMMANDS = [COMMAND.of(f"c1/inv{number:02d}") for number in range(1, 18)]


def test_an_external_agent_that_is_silent_is_named_and_nobody_else() -> None:
    assert needed_words(COMMANDS, {"c1/inv07"}) == "c1/inv07/command"


def test_without_one_the_first_few_are_named_and_the_rest_counted() -> None:
    assert needed_words(COMMANDS, ()) == (
        "c1/inv01/command, c1/inv02/command, c1/inv03/command and 14 more"
    )
    assert needed_words(COMMANDS, {"c2"}).endswith(" and 14 more")
    assert needed_words(COMMANDS[:2], ()) == "c1/inv01/command, c1/inv02/command"


def test_where_all_commands_are_there_it_is_the_recorder() -> None:
    assert needed_words((), {"c1/inv07"}) == "the recorder"
