"""Times and durations in the user's words: one grammar for options, scenarios and fault rules.

duration      90s  15m  1h30m  0.5h  50ms       units h, m, s, ms, us, in this order
time          12:30  9:05:00  2010-04-01T12:30  2010-04-01T12:30:00-10:00
range         A..B
"""

from __future__ import annotations

import re
from datetime import datetime, time
from typing import Final

from bus_schemas.errors import InputError

LONGEST_S: Final = 31 * 86400.0
"""The longest run."""

FIRST_YEAR: Final = 1900
LAST_YEAR: Final = 2200

_UNITS_S: Final = {"h": 3600.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6}
_NUMBER: Final = r"\d+(?:\.\d+)?"
_DURATION: Final = re.compile("".join(f"(?:({_NUMBER}){unit})?" for unit in _UNITS_S))


def duration_s(text: str) -> float | None:
    """Return the seconds of a duration with units, such as `1h30m`; None if the text is none."""
    found = _DURATION.fullmatch(text)
    if not text or found is None:
        return None
    parts = zip(found.groups(), _UNITS_S.values(), strict=True)
    return sum(float(number) * unit_s for number, unit_s in parts if number)


def parse_duration_s(given: str | float, where: str) -> float:
    """Return the length of a run [s]: a duration with units, or seconds without."""
    text = str(given)
    found_s = float(text) if re.fullmatch(_NUMBER, text) else duration_s(text)
    if found_s is None or not 0.0 < found_s <= LONGEST_S:
        raise InputError(
            f"{where}: expected seconds above 0, or a duration such as 90s, 15m or 1h30m, at most "
            f"{LONGEST_S / 86400:g} days, got {text[:40]}"
        )
    return found_s


def read_time(text: str) -> time | datetime | None:
    """Return a time of day, or a date with a time; None if the text is neither."""
    iso = re.sub(r"(^|\d[T ])(?=\d:)", r"\g<1>0", text)  # 9:05 is 09:05.
    try:
        return time.fromisoformat(iso) if re.match(r"\d\d:", iso) else datetime.fromisoformat(iso)
    except ValueError:
        return None


def parse_time(text: str, where: str) -> time | datetime:
    """Return a local time, or a date with a time in a year that a run may be in."""
    text = str(text)  # Python may give another type.
    moment = read_time(text)
    if isinstance(moment, time) and moment.tzinfo is not None:
        raise InputError(f"{where}: expected a date with a time in another zone, got {text[:40]}")
    if moment is None or (
        isinstance(moment, datetime) and not FIRST_YEAR <= moment.year <= LAST_YEAR
    ):
        raise InputError(
            f"{where}: expected a local time such as 12:30 or 2010-04-01T12:30:00, "
            f"year {FIRST_YEAR} to {LAST_YEAR}, got {text[:40]}"
        )
    return moment


def on_day(moment: time | datetime, day: datetime) -> datetime:
    """Return a time in the zone of a day; a time without a date is one of that day."""
    if isinstance(moment, time):
        moment = datetime.combine(day.date(), moment)
    return moment.astimezone(day.tzinfo) if moment.tzinfo else moment.replace(tzinfo=day.tzinfo)


def split_range(text: str, where: str) -> tuple[str, str]:
    begin, _, end = (part.strip() for part in text.partition(".."))
    if not begin or not end:
        raise InputError(f"{where}: expected a range A..B, got {text[:40]}")
    return begin, end
