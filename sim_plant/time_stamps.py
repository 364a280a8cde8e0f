"""Time stamps as loggers, archives and spreadsheets write them, brought to UTC."""

from __future__ import annotations

import re
from typing import Final, Literal
from zoneinfo import ZoneInfo, available_timezones

import pandas as pd
from pandas.tseries.api import guess_datetime_format

from bus_schemas.errors import InputError
from sim_plant.table_layout import Layout, is_time, name_and_unit

_ZONED: Final = r"(?:\d\d:\d\d(?::\d\d(?:\.\d+)?)?|T\d{4,6})\s*(?:Z|[+-]\d\d(?::?\d\d)?)$"
_PLAIN: Final = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d(:\d\d)?(Z|[+-]\d\d:\d\d)")
_FIXED: Final = {
    **{"HST": "Etc/GMT+10", "AKST": "Etc/GMT+9", "PST": "Etc/GMT+8", "MST": "Etc/GMT+7"},
    **{"CST": "Etc/GMT+6", "EST": "Etc/GMT+5", "UTC": "UTC", "GMT": "UTC", "CET": "Etc/GMT-1"},
}
"""Zones by the short names that archives write in a header, or after the time."""

_PARTS: Final = {
    "year": ("year", "yr", "yyyy", "jahr", "année", "year_rtm"),
    "month": ("month", "mo", "mm", "monat", "mois"),
    "day": ("day", "dd", "tag", "jour", "doy", "day of year", "jday", "julian day", "day_rtm"),
    "hour": ("hour", "hr", "hh", "stunde", "heure"),
    "minute": ("minute", "min", "mi"),
    "second": ("second", "sec", "ss", "sekunde", "seconde"),
    "clock": (
        *("time", "zeit", "uhrzeit", "hhmm", "hourmin", "hour_minute", "hour_minute_rtm"),
        *("utc_time", "lst_time"),
    ),
}
"""Names of columns that hold a part of the time stamp; a day without a month is of the year."""

_CLOCK: Final = re.compile(r"\d{1,2}:\d{2}(:\d{2}.*)?( [AaPp][Mm])?")
_EPOCH_UNITS: Final[dict[int, Literal["s", "ms", "us", "ns"]]] = {
    10: "s",
    13: "ms",
    16: "us",
    19: "ns",
}
_EXCEL_DAYS: Final = (30_000.0, 80_000.0)


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
    row = layout.sample[0] if layout.sample else ()
    dated = [at for at, cell in enumerate(row) if _has_date(cell)]
    clocks = [at for at, cell in enumerate(row) if _CLOCK.fullmatch(cell)]
    if not dated:
        dated = [at for at, cell in enumerate(row) if re.fullmatch(r"(19|20)\d{6}", cell)]
        names = [name.strip().lower() for name in layout.header]
        of_digits = [at for at, name in enumerate(names[: len(row)]) if name in _PARTS["clock"]]
        clocks = clocks or [at for at in of_digits if re.fullmatch(r"\d{1,6}", row[at])]
        if not dated or not clocks:
            return (clocks[0] if clocks else 0,)
    if ":" not in row[dated[0]] and clocks and not re.search(r"[T ]\d", row[dated[0]]):
        return dated[0], clocks[0]
    return (dated[0],)


def stamp_text(layout: Layout, fields: pd.DataFrame) -> pd.Series:
    """Return the time stamps of a table, put together where they stand in several columns."""
    cells = [fields.iloc[:, at].astype(str).str.strip() for at in stamp_columns(layout)]
    parts = dict(zip(_parts(layout), cells, strict=False))
    if not parts:
        return cells[0] if len(cells) == 1 else _digits_as_date(cells[0]) + " " + _clock(cells[1])
    if "month" in parts:
        date = parts["year"] + "-" + parts["month"].str.zfill(2) + "-" + parts["day"].str.zfill(2)
    else:
        days = pd.to_datetime(
            parts["year"] + parts["day"].str.zfill(3), format="%Y%j", errors="coerce"
        )
        date = days.dt.strftime("%Y-%m-%d").fillna(parts["year"] + "-" + parts["day"])
    if "clock" in parts:
        return date + " " + _clock(parts["clock"])
    nought = pd.Series("00", fields.index)
    times = [parts.get(part, nought).str.zfill(2) for part in ("hour", "minute", "second")]
    return date + " " + times[0] + ":" + times[1] + ":" + times[2]


def _digits_as_date(text: pd.Series) -> pd.Series:
    return text.str.replace(r"^(\d{4})(\d\d)(\d\d)$", r"\1-\2-\3", regex=True)


def _clock(text: pd.Series) -> pd.Series:
    """Write 930, which loggers mean as half past nine, as 09:30; leave times with marks alone."""
    if text.str.contains(":", regex=False).all():
        return text
    digits = text.str.zfill(6 if text.str.len().max() > 4 else 4)
    return digits.str.replace(r"^(\d\d)(\d\d)(\d\d)?$", r"\1:\2:\3", regex=True).str.rstrip(":")


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
    if re.match(r"\d{1,2}:\d\d", first):  # Without a date, for which pandas takes today.
        return pd.Series(pd.NaT, index=text.index)
    is_12_hours = re.search(r"[AaPp][Mm]$", first) is not None
    if re.match(r"\d{4}[-/.]", first) and not is_12_hours:
        if first[4] != "-":
            text = text.str.replace(first[4], "-", n=2, regex=False)
        return pd.to_datetime(text, format="ISO8601", utc=utc, errors="coerce")
    day_first = _is_day_first(known, first, dates, name)
    form = _of_12_hours(first, day_first) if is_12_hours else None
    form = form or guess_datetime_format(first, dayfirst=day_first) or "mixed"
    found = pd.to_datetime(text, format=form, dayfirst=day_first, utc=utc, errors="coerce")
    again = found.isna() & text.notna()
    if again.any():  # Of another form than the first one, such as without a fraction.
        other: pd.Series = text[again]
        found[again] = pd.to_datetime(
            other, errors="coerce", dayfirst=day_first, utc=utc, format="mixed"
        )
    return found


def _of_12_hours(first: str, day_first: bool) -> str | None:
    """Return the form of time stamps with AM or PM, if their date is of numbers."""
    found = re.fullmatch(r"(\d{1,4})([-/.])\d{1,2}\2(\d{1,4}) \d{1,2}:\d\d(:\d\d)?( ?)..", first)
    if found is None:
        return None
    year = "%Y" if len(found[3]) == 4 else "%y"
    order = ("%d", "%m", year) if day_first else ("%m", "%d", year)
    date = found[2].join(("%Y", "%m", "%d") if len(found[1]) == 4 else order)
    return f"{date} %I:%M{':%S' if found[4] else ''}{found[5]}%p"


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
