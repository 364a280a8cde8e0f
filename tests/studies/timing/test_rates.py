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
    "text", ["0", "-5", "nan", "fast", "5,,10", "1001", "inf", "20..10", "5,5", "10..2000", ""]
)
def test_what_is_no_rate_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--rate: expected") as refusal:
        parse_rates(text)
    assert f"got {text}" in str(refusal.value)
