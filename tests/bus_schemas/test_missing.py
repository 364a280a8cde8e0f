"""What the entries of `missing` say."""

from __future__ import annotations

import pytest

from bus_schemas.messages import Missing, parse_missing


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ("c1/inv07/impp", Missing("c1/inv07/impp", None)),
        ("c1/inv07/impp@41", Missing("c1/inv07/impp", 41)),
        ("dispatch@0", Missing("dispatch", 0)),
        ("c1/impp@-3", Missing("c1/impp@-3", None)),
        ("c1/impp@" + "9" * 18, Missing("c1/impp", 10**18 - 1)),
        ("c1/impp@1" + "0" * 18, Missing("c1/impp@1" + "0" * 18, None)),
        ("c1/impp@007", Missing("c1/impp@007", None)),
        ("c1/impp@\u0661\u0662", Missing("c1/impp@\u0661\u0662", None)),
    ],
)
def test_an_entry_is_a_key_with_or_without_a_cycle(entry: str, expected: Missing) -> None:
    assert parse_missing(entry) == expected
    assert str(parse_missing(entry)) == entry
