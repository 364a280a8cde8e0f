"""Time stamps as loggers, archives and spreadsheets write them, brought to UTC."""

from __future__ import annotations

import re
from typing import Final, Literal
from zoneinfo import available_timezones

import pandas as pd
from pandas.tseries.api import guess_datetime_format

from bus_schemas.errors import InputError
from sim_plant.table_layout import Layout, is_clock, is_date, name_and_unit

_ZONED: Final = r"(?:\d\d:\d\d(?::\d\d(?:\.\d+)?)?|T\d{4,6})\s*(?:Z|[+-]\d\d(?::?\d\d)?)$"
_PLAIN: Final = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d(:\d\d)?(Z|[+-]\d\d:\d\d)")
_FIXED: Final = {
    **{"HST": "Etc/GMT+10", "AKST": "Etc/GMT+9", "PST": "Etc/GMT+8", "MST": "Etc/GMT+7"},
    **{"CST": "Etc/GMT+6", "EST": "Etc/GMT+5", "UTC": "UTC", "GMT": "UTC", "CET": "Etc/GMT-1"},
}
"""Zones by the short names that archives write in a header, or after the time."""

_PARTS: Final = {
    "year": ("year", "yr", "yyyy", "jahr", "year_rtm"),
    "month": ("month", "mo", "mm", "monat"),
    "day": ("day", "dd", "tag", "doy", "day of year", "jday", "julian day", "day_rtm"),
    "hour": ("hour", "hr", "hh", "stunde"),
    "minute": ("minute", "min", "mi"),
    "second": ("second", "sec", "ss", "sekunde"),
    "clock": (
        *("time", "zeit", "uhrzeit", "hhmm", "hrmn", "hourmin", "hour_minute", "hour_minute_rtm"),
        *("utc_time", "lst_time"),
    ),
}
"""Names of columns that hold a part of the time stamp; a day without a month is of the year."""

_EPOCH_UNITS: Final[dict[int, Literal["s", "ms", "us", "ns"]]] = {
    10: "s",
    13: "ms",
    16: "us",
    19: "ns",
}
_EXCEL_DAYS: Final = (30_000.0, 80_000.0)
_AS_PANDAS_HAS_IT: Final = {
    r"\s{2,}": " ",
    r"(:\d\d),(\d)": r"\1.\2",
    r"^(\d{4})[/.](\d{1,2})[/.]": r"\1-\2-",
    r"^(\d{1,2}([-/.])\d{1,2}\2)(\d\d)(?!\d)": r"\g<1>20\3",
}
_MOST_FORMS: Final = 3
"""Forms of time stamps in one file, such as with and without a fraction."""


def _parts(layout: Layout) -> dict[str, int]:
    """Return the columns of the parts of a time stamp, by their names; none, if they lack some."""
    names = [name_and_unit(name.strip())[0].lower() for name in layout.header]
    found = {
        part: next(at for at, name in enumerate(names) if name in known)
        for part, known in _PARTS.items()
        if not set(known).isdisjoint(names)
    }
    is_whole = {"year", "day"} <= found.keys() and not found.keys().isdisjoint({"hour", "clock"})
    return found if is_whole else {}


def stamp_columns(layout: Layout) -> tuple[int, ...]:
    """Return the columns that make up a time stamp."""
    if parts := _parts(layout):
        return tuple(parts.values())
    row = list(enumerate(layout.first))
    of_digits = [at for at, cell in row if re.fullmatch(r"(19|20)\d{6}", cell)]
    dated = [at for at, cell in row if is_date(cell)] or of_digits
    clocks = [at for at, cell in row if is_clock(cell)]
    for at, cell in row:
        if layout.header[at].strip().lower() in _PARTS["clock"] and cell.isdigit():
            clocks.append(at)
    if dated and clocks and not re.search(r":|\dT\d|^\d{8}[ .]\d", layout.first[dated[0]]):
        return dated[0], clocks[0]
    return ((dated or clocks or [0])[0],)


def stamp_text(layout: Layout, fields: pd.DataFrame) -> pd.Series:
    """Return the time stamps of a table, put together where they stand in several columns."""
    cells = [fields.iloc[:, at].astype(str).str.strip() for at in stamp_columns(layout)]
    parts = dict(zip(_parts(layout), cells, strict=False))
    if not parts:
        date = cells[0].str.replace(r"^(\d{4})(\d\d)(\d\d)$", r"\1-\2-\3", regex=True)
        return cells[0] if len(cells) == 1 else date + " " + _clock(cells[1])
    if "month" in parts:
        date = parts["year"] + "-" + parts["month"].str.zfill(2) + "-" + parts["day"].str.zfill(2)
    else:
        of_year = parts["year"] + parts["day"].str.zfill(3)
        days = pd.to_datetime(of_year, format="%Y%j", errors="coerce")
        date = days.dt.strftime("%Y-%m-%d").fillna(of_year)
    if "clock" in parts:
        return date + " " + _clock(parts["clock"])
    nought = pd.Series("00", fields.index)
    times = [parts.get(part, nought).str.zfill(2) for part in ("hour", "minute", "second")]
    return date + " " + times[0] + ":" + times[1] + ":" + times[2]


def _clock(text: pd.Series) -> pd.Series:
    """Write 930, which loggers mean as half past nine, as 09:30; leave times with marks alone."""
    if text.str.contains(":", regex=False).all():
        return text
    digits = text.str.zfill(6 if text.str.len().max() > 4 else 4)
    return digits.str.replace(r"^(\d\d)(\d\d)(\d\d)?$", r"\1:\2:\3", regex=True).str.rstrip(":")


def parsed_stamps(
    text: pd.Series, hint: str, dates: str | None, name: str
) -> tuple[pd.Series, list[str]]:
    """Return time stamps, aware if they say their zone, NaT where they are none; and notes.

    `hint` is their header. `dates`: `day-first` or `month-first`, where the stamps leave it open.
    """
    first = text.iloc[0] if len(text) else ""
    if _PLAIN.fullmatch(first):  # Fast, for large files.
        plain = pd.to_datetime(text, utc=True, errors="coerce")  # All are as the first one.
        if not plain.isna().any():
            return plain, []
    if (of_numbers := _of_numbers(text, first)) is not None:
        return of_numbers
    zone, notes = _named_zone(hint), list[str]()
    if zone:
        notes.append(f"time stamps are in {zone}, as the header says")
    if re.match(r"\d{4}-\S+/\d{4}-", first):  # An interval: begin and end.
        text = text.str.partition("/")[0]
        notes.append("time stamps are intervals, of which the begin was taken")
    if (ending := re.search(r" ([A-Z]{3,4})$", first)) and ending[1] in _FIXED:
        zone, text = _FIXED[ending[1]], text.str.removesuffix(ending[0])
    for old, new in _AS_PANDAS_HAS_IT.items():
        if re.search(old, first):
            text = text.str.replace(old, new, regex=True)
    midnight = text.str.contains(r"[T ]24:00", regex=True)
    text = text.str.replace(r"([T ])24:00", r"\g<1>00:00", regex=True) if midnight.any() else text
    zoned = text.str.contains(_ZONED, regex=True)
    is_zoned = bool(zoned.any())
    found = _parsed(text.where(zoned) if is_zoned else text, dates, name, utc=is_zoned)
    found = found + pd.to_timedelta(midnight.astype(int), unit="D")
    return (found.dt.tz_localize(zone) if zone and not is_zoned else found), notes


def _named_zone(hint: str) -> str:
    """Return the zone that a header names: GMT-07:00, MST, Europe/Berlin."""
    if offset := re.search(r"(?:UTC|GMT) ?([+-])(\d{1,2})(?::?(\d\d))?", hint):
        return f"UTC{offset[1]}{offset[2]:0>2}:{offset[3] or '00'}"
    words = re.findall(r"[A-Za-z]+(?:/[A-Za-z_]+)*", hint)
    fixed = [_FIXED[word.upper()] for word in words if word.upper() in _FIXED]
    named = [word for word in words if "/" in word and word in available_timezones()]
    return next(iter(fixed + named), "")


def _of_numbers(text: pd.Series, first: str) -> tuple[pd.Series, list[str]] | None:
    """Read seconds since 1970, or days of a spreadsheet; None: they are something else."""
    if not re.fullmatch(r"\d+([.,]\d+)?", first):
        return None
    numbers = pd.to_numeric(text.str.replace(",", ".", regex=False), errors="coerce")
    unit = _EPOCH_UNITS.get(len(re.split("[.,]", first)[0]))
    if unit:
        found = pd.to_datetime(numbers, unit=unit, utc=True, errors="coerce").dt.round("us")
        return found, [f"time stamps are {unit} since 1970"]
    if not first.isdigit() and _EXCEL_DAYS[0] < numbers.iloc[0] < _EXCEL_DAYS[1]:
        found = pd.Timestamp("1899-12-30") + pd.to_timedelta(numbers, unit="D")
        return found.dt.round("s"), ["time stamps are a spreadsheet's days since 1899-12-30"]
    return None


def _parsed(text: pd.Series, dates: str | None, name: str, *, utc: bool) -> pd.Series:
    """Read time stamps of some forms strictly: a lenient reader finds a time in any text."""
    found = pd.Series(pd.NaT, text.index, dtype="datetime64[us, UTC]" if utc else "datetime64[us]")
    for _ in range(_MOST_FORMS):
        left: pd.Series = text[found.isna() & text.notna()]
        form = _form(left, dates, name) if len(left) else None
        if form is None:
            break
        found[left.index] = pd.to_datetime(left, format=form, utc=utc, errors="coerce")
    return found


def _form(text: pd.Series, dates: str | None, name: str) -> str | None:
    """Return the form of the first time stamp as pandas knows it; None: it is none."""
    first = text.iloc[0]
    half = re.search(r" ?[AaPp][Mm]$", first)
    if re.match(r"\d{4}-", first) and half is None:
        return "ISO8601"
    day_first = re.match(r"\d{4}", first) is None and _is_day_first(text, first, dates, name)
    form = guess_datetime_format(first.removesuffix(half[0] if half else ""), dayfirst=day_first)
    if half is None or form is None:
        return form
    return form.replace("%H", "%I") + half[0][:-2] + "%p"


def _is_day_first(text: pd.Series, first: str, dates: str | None, name: str) -> bool:
    """Tell whether the day comes before the month; refuse what the stamps leave open."""
    parts = re.match(r"(\d{1,2})([-/.])(\d{1,2})\2\d{2,4}", first)
    if parts is None or parts[2] == ".":
        return True
    days = text.str.extract(r"^(\d{1,2})[-/](\d{1,2})", expand=True).drop_duplicates().astype(float)
    is_day = (days > 12.0).any()
    if is_day[0] != is_day[1]:
        return bool(is_day[0])
    if (days[0] == days[1]).all():
        return True
    if dates is None or is_day[0]:
        raise InputError(
            f"{name}: expected irradiance.dates (--dates), day-first or month-first, since the "
            f"time stamps leave it open, got {first}"
        )
    return dates == "day-first"


def with_zone(times: pd.DatetimeIndex, timezone: str | None) -> tuple[pd.DatetimeIndex, list[str]]:
    """Return times in UTC, NaT where the clocks of the zone skip or repeat them; and notes."""
    if times.tz is not None:
        return times.tz_convert("UTC"), []
    if timezone is None:
        raise InputError(
            "expected time stamps with Z or an offset, such as 2013-09-08T09:15:00Z, or their zone "
            f"(irradiance.timezone, --timezone), got {times[0].isoformat()}"
        )
    try:
        local = times.tz_localize(timezone, ambiguous="infer", nonexistent="NaT")
    except ValueError:  # No time comes twice, so that none tells which one it is.
        local = times.tz_localize(timezone, ambiguous="NaT", nonexistent="NaT")
    return local.tz_convert("UTC"), [f"time stamps without an offset are taken as {timezone}"]
