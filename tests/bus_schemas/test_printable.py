"""What came from elsewhere is shown as it is, but a terminal obeys none of it."""

from __future__ import annotations

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from plans_by_hand import plan_at_noon
from rich.console import Console

from bus_schemas.printable import printable
from launch_scripts.launcher.live_view import view_for
from studies.tables import Table, key_column, print_table

HOSTILE = "power[/kw] \x1b[2J\x1b]0;owned\x07 \x9b31m [/red] [bold]"


@given(st.text())
def test_no_control_character_is_left(text: str) -> None:
    shown = printable(text)
    assert all(one.isprintable() or one in "\n\t" for one in shown)
    if text.isprintable():
        assert shown == text


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_launched_run_shows_names_with_markup_and_escapes_as_text(is_terminal: bool) -> None:
    output = io.StringIO()
    console = Console(file=output, force_terminal=is_terminal, width=200, color_system=None)
    view = view_for(console, plan_at_noon())
    view.say(HOSTILE)
    print_table(console, Table(HOSTILE, (key_column("key"),), ((HOSTILE,),), (HOSTILE,)))
    shown = output.getvalue()
    assert "power[/kw]" in shown
    assert "[/red] [bold]" in shown
    assert "\x9b" not in shown
    assert "\x1b]" not in shown
    assert "\x1b[2J" not in shown
