"""What the entries of `missing` say."""

from __future__ import annotations

import pytest

from bus_schemas.missing import Missing, in_words, parse_missing


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ("c1/inv07/impp", Missing("c1/inv07/impp", None)),
        ("c1/inv07/impp@41", Missing("c1/inv07/impp", 41)),
        ("dispatch@0", Missing("dispatch", 0)),
        ("c1/impp@", Missing("c1/impp@", None)),
        ("c1/impp@-3", Missing("c1/impp@-3", None)),
        ("", Missing("", None)),
        ("c1/impp@" + "9" * 18, Missing("c1/impp", 10**18 - 1)),
        ("c1/impp@1" + "0" * 18, Missing("c1/impp@1" + "0" * 18, None)),
        ("c1/impp@" + "9" * 5000, Missing("c1/impp@" + "9" * 5000, None)),
        ("c1/impp@007", Missing("c1/impp@007", None)),
        ("c1/impp@\u0661\u0662", Missing("c1/impp@\u0661\u0662", None)),
        ("c1/impp@\u00b2", Missing("c1/impp@\u00b2", None)),
        ("@1", Missing("", 1)),
    ],
)
def test_an_entry_is_a_key_with_or_without_a_cycle(entry: str, expected: Missing) -> None:
    assert parse_missing(entry) == expected
    assert str(parse_missing(entry)) == entry


def test_in_words() -> None:
    assert in_words(("c1/impp", "c2/impp@3")) == "without c1/impp, used c2/impp of cycle 3"
