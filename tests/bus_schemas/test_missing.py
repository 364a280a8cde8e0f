"""What the entries of `missing` say."""

from __future__ import annotations

import pytest

from bus_schemas.missing import SKIPPED, Absence, absence, in_words, skipped_cycles


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ("c1/inv07/impp", Absence("c1/inv07/impp", None)),
        ("c1/inv07/impp@41", Absence("c1/inv07/impp", 41)),
        ("dispatch@0", Absence("dispatch", 0)),
        ("skipped@60", Absence(SKIPPED, 60)),
        ("c1/impp@", Absence("c1/impp@", None)),
        ("c1/impp@-3", Absence("c1/impp@-3", None)),
        ("", Absence("", None)),
        ("skipped@" + "9" * 5000, Absence("skipped@" + "9" * 5000, None)),
        ("c1/impp@" + "9" * 18, Absence("c1/impp", 10**18 - 1)),
        ("c1/impp@1" + "0" * 18, Absence("c1/impp@1" + "0" * 18, None)),
        ("c1/impp@007", Absence("c1/impp@007", None)),
        ("c1/impp@\u0661\u0662", Absence("c1/impp@\u0661\u0662", None)),
        ("c1/impp@\u00b2", Absence("c1/impp@\u00b2", None)),
        ("@1", Absence("", 1)),
    ],
)
def test_an_entry_is_a_key_with_or_without_a_cycle(entry: str, expected: Absence) -> None:
    assert absence(entry) == expected
    assert str(absence(entry)) == entry


@pytest.mark.parametrize(
    ("missing", "expected"),
    [
        ((), range(0)),
        (("c1/impp", "c2/impp@3"), range(0)),
        (("skipped@60", "c1/impp"), range(60, 63)),
        (("skipped@63",), range(63, 64)),
        (("skipped@64",), range(0)),
        (("skipped",), range(0)),
        (("skippedone/impp@3",), range(0)),
    ],
)
def test_the_skipped_cycles_are_those_up_to_the_message_or_its_own(
    missing: tuple[str, ...], expected: range
) -> None:
    assert skipped_cycles(missing, cycle=63) == expected


@pytest.mark.parametrize(
    ("missing", "expected"),
    [
        ((), ""),
        (("c1/impp", "c2/impp"), "without c1/impp, c2/impp"),
        (("c1/impp@41",), "used c1/impp of cycle 41"),
        (
            ("skipped@1200", "c1/impp", "c2/impp@1210"),
            "skipped cycles 1,200 to 1,233; without c1/impp; used c2/impp of cycle 1,210",
        ),
        (("skipped@1233",), "skipped cycle 1,233"),
        (("skipped@1234",), "skipped cycle 1,234"),
        (("skipped@" + "9" * 30,), "without skipped@" + "9" * 30),
    ],
)
def test_in_words(missing: tuple[str, ...], expected: str) -> None:
    assert in_words(missing, cycle=1234) == expected
