"""A tidy table as a CSV file: a line of column names, then a line for each row.

Numbers are written with the digits that give exactly the same double when read. Times are local
ISO 8601 with the offset from UTC.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Final
from zoneinfo import ZoneInfo

from agents.plan import RunPlan
from bus_schemas.errors import InputError
from recordings.export.tables import Row, Table

_NS: Final = 1_000_000_000


class CsvTable:
    """A CSV file that is being written.

    Parameters
    ----------
    path
        File to write; there is none yet.
    table
        Gives the columns.
    plan
        Of the run: gives the local time.
    """

    def __init__(self, path: Path, table: Table, plan: RunPlan) -> None:
        self._iso_time = iso_times(plan)
        self._file = path.open("x", encoding="utf-8", newline="")
        self._lines = csv.writer(self._file, lineterminator="\n")
        self._lines.writerow([column.name for column in table.columns])

    def write(self, rows: Iterable[Row]) -> None:
        """Write some rows."""
        iso_time = self._iso_time
        self._lines.writerows((iso_time(time_ns), *cells) for time_ns, *cells in rows)  # type: ignore[arg-type]

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def iso_times(plan: RunPlan) -> Callable[[int], str]:
    """Return a function that writes a simulated time [ns] as local ISO 8601 with its offset.

    Seconds have as many digits as the beginnings of the run's cycles need: 0, 3, 6 or 9.
    """
    zone = ZoneInfo(plan.timezone)
    usual_digits = _second_digits(plan.start_time_ns, plan.cycle_ns)

    @lru_cache(maxsize=16)  # The messages of one cycle follow each other, and all have its time.
    def iso_time(time_ns: int) -> str:
        seconds, rest_ns = divmod(time_ns, _NS)
        try:
            text = datetime.fromtimestamp(seconds, zone).isoformat(timespec="seconds")
        except (OverflowError, ValueError, OSError):
            raise InputError(
                f"sim_time_ns is {time_ns}, accepted is a time of the years 1 to 9999"
            ) from None
        digits = max(usual_digits, _second_digits(rest_ns))
        fraction = f".{rest_ns:09}"[: digits + 1] if digits else ""
        return f"{text[:19]}{fraction}{text[19:]}"

    return iso_time


def _second_digits(*times_ns: int) -> int:
    """Return how many digits after the second show all of these times exactly: 0, 3, 6 or 9."""
    return next(
        digits
        for digits in (0, 3, 6, 9)
        if all(time_ns % 10 ** (9 - digits) == 0 for time_ns in times_ns)
    )
