"""Time stamps as loggers, archives and spreadsheets write them, brought to UTC."""

from __future__ import annotations

import re
from typing import Final, Literal
from zoneinfo import ZoneInfo, available_timezones

import pandas as pd
from pandas.tseries.api import guess_datetime_format

from bus_schemas.errors import InputError
from sim_plant.table_layout import Layout, is_time

_ZONED: Final = r"(?:\d\d:\d\d(?::\d\d(?:\.\d+)?)?|T\d{4,6})\s*(?:Z|[+-]\d\d(?::?\d\d)?)$"
_PLAIN: Final = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d(:\d\d)?(Z|[+-]\d\d:\d\d)")
_FIXED: Final = {
    **{"HST": "Etc/GMT+10", "AKST": "Etc/GMT+9", "PST": "Etc/GMT+8", "MST": "Etc/GMT+7"},
    **{"CST": "Etc/GMT+6", "EST": "Etc/GMT+5", "UTC": "UTC", "GMT": "UTC", "CET": "Etc/GMT-1"},
}
"""Zones by the short names that archives write in a header, or after the time."""

_PARTS: Final = ("year", "month", "day", "hour", "minute")
_EPOCH_UNITS: Final[dict[int, Literal["s", "ms", "us", "ns"]]] = {
    10: "s",
    13: "ms",
    16: "us",
    19: "ns",
}
_EXCEL_DAYS: Final = (30_000.0, 80_000.0)


def stamp_columns(layout: Layout) -> tuple[int, ...]:
    """Return the columns that make up a time stamp."""
    names = [name.strip().lower() for name in layout.header]
    if set(_PARTS[:4]) <= set(names):
        return tuple(names.index(part) for part in _PARTS if part in names)
    row = layout.sample[0] if layout.sample else ()
    dated = [at for at, cell in enumerate(row) if _has_date(cell)]
    clocks = [at for at, cell in enumerate(row) if re.fullmatch(r"\d{1,2}:\d{2}(:\d{2}.*)?", cell)]
    if not dated:
        return (clocks[0] if clocks else 0,)
    if ":" not in row[dated[0]] and clocks and not re.search(r"[T ]\d", row[dated[0]]):
        return dated[0], clocks[0]
    return (dated[0],)


def _has_date(cell: str) -> bool:
    return is_time(cell) and re.match(r"\d{1,2}:\d{2}", cell) is None


def parsed_stamps(
    text: pd.Series, hint: str, dates: str | None, name: str
) -> tuple[pd.Series, list[str]]:
    """Return time stamps, aware if they say their zone, NaT where they are none; and notes.

    `hint` is their header. `dates`: `day-first` or `month-first`, where the stamps leave it open.
    """
    if _PLAIN.fullmatch(str(text.iloc[0]) if len(text) else ""):
        plain = pd.to_datetime(text, utc=True, errors="coerce")  # All are as the first one.
        if not plain.isna().any():
            return plain, []
    text = text.str.strip().str.replace(r"\s{2,}", " ", regex=True)
    first = text.iloc[0] if len(text) else ""
    if re.fullmatch(r"\d+([.,]\d+)?", first):
        return _of_numbers(text.str.replace(",", ".", regex=False), first.replace(",", "."), hint)
    zone, notes = _named_zone(hint), list[str]()
    if re.match(r"\d{4}-\S+/\d{4}-", first):  # An interval: begin and end.
        text, first = text.str.partition("/")[0], first.partition("/")[0]
        notes.append("time stamps are intervals, of which the begin was taken")
    if zone:
        notes.append(f"time stamps are in {zone}, as the header says")
    if ending := re.search(r"\s([A-Z]{3,4})$", first):
        zone = _FIXED.get(ending[1], "")
        text = text.str.removesuffix(ending[0]) if zone else text
    midnight = text.str.contains(r"[T ]24:00", regex=True)
    if midnight.any():
        text = text.str.replace(r"([T ])24:00", r"\g<1>00:00", regex=True)
    if "," in first:
        text = text.str.replace(r"(:\d\d),(\d)", r"\1.\2", regex=True)
    zoned = text.str.contains(_ZONED, regex=True)
    is_zoned = bool(zoned.any())
    found = _parsed(text.where(zoned) if is_zoned else text, dates, name, utc=is_zoned)
    found = found + pd.to_timedelta(midnight.astype(int), unit="D")
    if zone and not is_zoned:
        found = found.dt.tz_localize(zone)
    return found, notes


def _named_zone(hint: str) -> str:
    words = re.findall(r"[A-Za-z]+(?:/[A-Za-z_]+)*", hint)
    fixed = [_FIXED[word.upper()] for word in words if word.upper() in _FIXED]
    return (
        fixed[0]
        if fixed
        else next((one for one in words if "/" in one and one in available_timezones()), "")
    )


def _of_numbers(text: pd.Series, first: str, hint: str) -> tuple[pd.Series, list[str]]:
    """Read seconds since 1970, days of a spreadsheet, or digits without marks."""
    whole = first.partition(".")[0]
    if len(whole) in {8, 12, 14} and whole[:2] in {"19", "20"}:
        form = "%Y%m%d%H%M%S"[: {8: 6, 12: 10, 14: 12}[len(whole)]]
        found = pd.to_datetime(text, format=form, errors="coerce")
        zone = _named_zone(hint)
        return (found.dt.tz_localize(zone) if zone else found), []
    numbers = pd.to_numeric(text, errors="coerce")
    unit = _EPOCH_UNITS.get(len(whole))
    if unit:
        note = f"time stamps are {unit} since 1970"
        return pd.to_datetime(numbers, unit=unit, utc=True, errors="coerce").dt.round("us"), [note]
    if "." in first and _EXCEL_DAYS[0] < numbers.iloc[0] < _EXCEL_DAYS[1]:
        found = pd.Timestamp("1899-12-30") + pd.to_timedelta(numbers, unit="D")
        return found.dt.round("s"), ["time stamps are a spreadsheet's days since 1899-12-30"]
    return pd.Series(pd.NaT, index=text.index), []


def _parsed(text: pd.Series, dates: str | None, name: str, *, utc: bool) -> pd.Series:
    known = text.dropna()
    first = known.iloc[0] if len(known) else ""
    if re.match(r"\d{4}[-/.]", first):
        if first[4] != "-":
            text = text.str.replace(first[4], "-", n=2, regex=False)
        return pd.to_datetime(text, format="ISO8601", utc=utc, errors="coerce")
    day_first = _is_day_first(known, first, dates, name)
    form = guess_datetime_format(first, dayfirst=day_first) or "mixed"
    found = pd.to_datetime(text, dayfirst=day_first, utc=utc, errors="coerce", format=form)
    again = found.isna() & text.notna()
    if again.any():  # Of another form than the first one, such as without a fraction.
        other: pd.Series = text[again]
        found[again] = pd.to_datetime(
            other, errors="coerce", dayfirst=day_first, utc=utc, format="mixed"
        )
    return found


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
    zone = ZoneInfo(timezone)
    try:
        local = times.tz_localize(zone, ambiguous="infer", nonexistent="NaT")
    except ValueError:  # No time comes twice, so that none tells which one it is.
        local = times.tz_localize(zone, ambiguous="NaT", nonexistent="NaT")
    note = f"time stamps without an offset are taken as {timezone}"
    return local.tz_convert("UTC"), [note]
