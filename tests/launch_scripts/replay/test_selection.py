"""Which messages go out, and on which keys, as the command line's words say."""

from __future__ import annotations

import pytest
from tapes_by_hand import PLAN

from bus_schemas.errors import InputError
from bus_schemas.signals import CLOCK, HELP, IMPP, READY, SIGNALS
from launch_scripts.replay.selection import select


def test_by_default_all_that_is_recorded_goes_out_on_its_own_key() -> None:
    selection = select(PLAN)
    assert dict(selection.key_of) == {
        port: PLAN.keys.key(port) for port in PLAN.keys.ports if port.signal.logged
    }
    assert selection.clock_key == "field/clock"
    assert not {READY, CLOCK}.intersection(port.signal for port in selection.key_of)


def test_signals_are_named_with_commas_between() -> None:
    selection = select(PLAN, signals="impp, help")
    assert {port.signal for port in selection.key_of} == {IMPP, HELP}
    assert len(selection.key_of) == 2 * len(PLAN.tree.nodes)
    assert selection.clock_key == "field/clock"


def test_signals_are_excluded_and_so_is_the_clock() -> None:
    selection = select(PLAN, exclude="impp,clock")
    assert {port.signal for port in selection.key_of} == {
        signal for signal in SIGNALS if signal.logged and signal is not IMPP
    }
    assert selection.clock_key is None


def test_a_remap_renames_the_beginning_of_keys_and_the_longest_wins() -> None:
    selection = select(
        PLAN,
        signals="impp",
        remaps=["field/c1=field/c9", "field/c1/a/impp=elsewhere", "field=meadow"],
    )
    assert sorted(selection.key_of.values()) == [
        "elsewhere",
        "field/c9/b/impp",
        "field/c9/impp",
        "meadow/c2/c/impp",
        "meadow/c2/d/impp",
        "meadow/c2/impp",
        "meadow/impp",
    ]
    assert selection.clock_key == "meadow/clock"


def test_a_remap_takes_whole_parts_of_keys() -> None:
    with pytest.raises(InputError, match="no key that is replayed begins with field/c"):
        select(PLAN, remaps=["field/c=field/d"])


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ({"signals": "imp"}, "signal 'imp': not in a recording, near are impp"),
        ({"signals": "ready"}, "signal 'ready': not in a recording"),
        ({"exclude": "wind"}, "signal 'wind': not in a recording"),
        ({"signals": "impp", "exclude": "impp"}, "--signals, --exclude: nothing is left to replay"),
        ({"remaps": ["field"]}, "--remap field: accepted is OLD=NEW"),
        ({"remaps": ["field=a/*"]}, "--remap field=a/[*]: accepted is OLD=NEW"),
        ({"remaps": ["field/c1=/c1"]}, "--remap field/c1=/c1: accepted is OLD=NEW"),
        ({"remaps": ["field/c1=field/c2"]}, "field/c1/.* and field/c2/.* would both become"),
    ],
)
def test_words_that_make_no_sense_are_refused(words: dict[str, str], complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        select(PLAN, **words)
