"""Which messages go out, and on which keys, as the command line's words say."""

from __future__ import annotations

import pytest
from replayed_runs import PLAN

from bus_schemas.errors import InputError
from bus_schemas.signals import CLOCK, HELP, IMPP, READY, SIGNALS
from recordings.replay.selection import select


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


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ({"signals": "imp"}, "signal 'imp': .*impp"),
        ({"signals": "ready"}, "signal 'ready': not in a recording"),
        ({"exclude": "wind"}, "signal 'wind': not in a recording"),
        ({"signals": "impp", "exclude": "impp"}, "--signals, --exclude: nothing is left to replay"),
    ],
)
def test_words_that_make_no_sense_are_refused(words: dict[str, str], complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        select(PLAN, **words)
