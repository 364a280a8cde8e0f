"""Times and durations in the user's words: one grammar for options, scenarios and fault rules.

seconds       90  90s  15m  1h30m  0.5h  50ms    since cycle 0, or a length; units h, m, s, ms, us
cycle         c90  cycle 90                      the number of a cycle, or a count of them
local time    12:30  9:05:00  2010-04-01T12:30  2010-04-01T12:30:00-10:00
range         A..B
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, time, timedelta
from typing import Final, NamedTuple, TypeAlias

from bus_schemas.errors import InputError

SHORTEST_CYCLE_S: Final = 0.001
LONGEST_S: Final = 31 * 86400.0
"""The longest run."""

FIRST_YEAR: Final = 1900
LAST_YEAR: Final = 2200

FORMS: Final = (
    "a local time (12:30, 2010-04-01T12:30:00), seconds since cycle 0 (90, 90s, 1h30m) or a cycle "
    "(c90)"
)

_UNITS_S: Final = {"h": 3600.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6}
_NUMBER: Final = r"\d+(?:\.\d+)?"
_DURATION: Final = re.compile("".join(f"(?:({_NUMBER}){unit})?" for unit in _UNITS_S))
_CYCLE: Final = re.compile(r"(?:c|cycle )\s*(\d{1,12})")


When: TypeAlias = str | float | timedelta | datetime | time
"""A time or a duration as Python gives it; those of pandas are of these types."""


class Cycle(NamedTuple):
    """A cycle by its number, or so many cycles."""

    number: int


def duration_s(text: str) -> float | None:
    """Return the seconds of a duration with units, such as `1h30m`; None if the text is none."""
    found = _DURATION.fullmatch(text)
    if not text or found is None:
        return None
    parts = zip(found.groups(), _UNITS_S.values(), strict=True)
    return sum(float(number) * unit_s for number, unit_s in parts if number)


def read_seconds(text: str) -> float | None:
    """Return a number, which is in seconds, or a duration; None if the text is neither."""
    return float(text) if re.fullmatch(_NUMBER, text) else duration_s(text)


def read_cycle(text: str) -> Cycle | None:
    found = _CYCLE.fullmatch(text)
    return Cycle(int(found[1])) if found else None


def _text(given: When) -> str:
    seconds = given.total_seconds() if isinstance(given, timedelta) else None
    return str(given).strip() if seconds is None else f"{seconds:.9f}"


def parse_duration_s(given: When, where: str, cycle_s: float | None = None) -> float:
    """Return the length of a run [s], which may be stated in cycles where their length is known."""
    text = _text(given)
    cycles = None if cycle_s is None else read_cycle(text)
    found_s = read_seconds(text) if cycles is None or cycle_s is None else cycles.number * cycle_s
    if found_s is None or not 0.0 < found_s <= LONGEST_S:
        in_cycles = "" if cycle_s is None else ", or cycles such as c90"
        raise InputError.of(
            where,
            f"expected seconds above 0, or a duration such as 90s, 15m or 1h30m{in_cycles}, at "
            f"most {LONGEST_S / 86400:g} days, got {text[:40]}",
        )
    return found_s


def read_time(text: str) -> time | datetime | None:
    """Return a time of day, or a date with a time; None if the text is neither."""
    iso = re.sub(r"(^|\d[T ])(?=\d:)", r"\g<1>0", text)  # 9:05 is 09:05.
    try:
        return time.fromisoformat(iso) if re.match(r"\d\d:", iso) else datetime.fromisoformat(iso)
    except ValueError:
        return None


def parse_moment(given: When, where: str) -> float | Cycle | time | datetime:
    """Return seconds since cycle 0, a cycle, a local time, or a date with a time."""
    text = _text(given)
    moment = read_seconds(text)
    if moment is not None:
        return min(moment, 2 * LONGEST_S)
    other = read_cycle(text) or read_time(text)
    if isinstance(other, time) and other.tzinfo is not None:
        raise InputError.of(where, f"expected a date with a time in another zone, got {text[:40]}")
    if other is None or (isinstance(other, datetime) and not FIRST_YEAR <= other.year <= LAST_YEAR):
        raise InputError.of(
            where, f"expected {FORMS}, year {FIRST_YEAR} to {LAST_YEAR}, got {text[:40]}"
        )
    return other


def on_day(moment: time | datetime, day: datetime, where: str) -> tuple[datetime, ...]:
    """Return a local time in the zone of a day, twice where the clocks of that night are put back.

    A time without a date is one of that day.
    """
    if isinstance(moment, time):
        moment = datetime.combine(day.date(), moment)
    zone = day.tzinfo
    if moment.tzinfo:
        return (moment.astimezone(zone),)
    both = (moment.replace(tzinfo=zone), moment.replace(tzinfo=zone, fold=1))
    back = [one.astimezone(UTC).astimezone(zone).replace(tzinfo=None) for one in both]
    if moment not in back:
        raise InputError.of(
            where,
            f"expected a local time that exists, such as {max(back):%H:%M}, since the clocks of "
            f"{zone} are put forward then, got {moment:%Y-%m-%d %H:%M:%S}",
        )
    return both if both[0].utcoffset() != both[1].utcoffset() else both[:1]


def split_range(text: str, where: str) -> tuple[str, str]:
    begin, _, end = (part.strip() for part in text.partition(".."))
    if not begin or not end:
        raise InputError.of(where, f"expected a range A..B, got {text[:40]}")
    return begin, end
