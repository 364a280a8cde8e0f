"""Rates are a number, several, a range or `auto`; what no clock can keep is refused."""

from __future__ import annotations

import pytest

from bus_schemas.errors import InputError
from studies.timing.rates import Rates, parse_rates


@pytest.mark.parametrize(
    ("text", "rates"),
    [
        ("20", Rates(listed_hz=(20.0,))),
        ("0.5", Rates(listed_hz=(0.5,))),
        ("5,10,20", Rates(listed_hz=(5.0, 10.0, 20.0))),
        ("1..200", Rates(search_hz=(1.0, 200.0))),
        ("auto", Rates(search_hz=(5.0, 1000.0))),
    ],
)
def test_rates_are_read(text: str, rates: Rates) -> None:
    assert parse_rates(text) == rates
    assert rates.single_hz == (rates.listed_hz[0] if text in {"20", "0.5"} else None)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0", "accepted is a number above 0"),
        ("-5", "accepted is a number above 0"),
        ("nan", "accepted is a number above 0"),
        ("fast", "'fast' is no number, accepted are a number of cycles a second such as 20"),
        ("5,,10", "'' is no number"),
        ("1001", "at most 1000 cycles/s; timers wake a process some 0.1 ms late"),
        ("inf", "at most 1000 cycles/s"),
        ("20..10", "the range is empty, accepted is for instance 1..200"),
        ("5,5", "a rate stands there twice"),
        ("10..2000", "--rate 10..2000: accepted is at most"),
    ],
)
def test_what_is_no_rate_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError) as refusal:
        parse_rates(text)
    assert str(refusal.value).startswith(f"--rate {text}: ")
    assert words in str(refusal.value)
