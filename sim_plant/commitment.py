"""The commitment: the power that the plant has promised to deliver, at every time step."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeAlias

import msgspec
import numpy as np
import pandas as pd
from msgspec import Meta

from agents.settings import OfClearSky, OfferedCommitment
from bus_schemas.errors import InputError
from sim_plant import Floats
from sim_plant.csv_tables import CsvTable, read_csv
from sim_plant.time_steps import check_coverage, step_ns

_LARGEST_KW = 1e8
_COLUMN = "commitment_kw"


class _Rule(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind"):
    """How the commitment is made."""


class ConstantCommitment(_Rule, frozen=True, tag="constant"):
    """The same power at every time step.

    power_kw: The committed power [kW].
    """

    power_kw: Annotated[float, Meta(ge=0.0, le=_LARGEST_KW)]


class ShareOfMedian(_Rule, frozen=True, tag="share-of-median"):
    """A share of the plant's median available power in the run, the same at every time step.

    This is hindsight: the median is known only after the run. It serves to compare control
    schemes at a like difficulty on different days.

    share: Share of the median.
    """

    share: OfClearSky


class ShareOfClearSky(_Rule, frozen=True, tag="share-of-clear-sky"):
    """A share of the power that the plant would have under a clear sky, known in advance.

    share: Share of the clear-sky power.
    """

    share: OfClearSky


class BelowAvailable(_Rule, frozen=True, tag="below-available"):
    r"""A smooth profile below the available power, as in the paper's case study.

    .. math:: P_{com}(t) = \lambda \, \overline{P_{MPP}}(t)

    where the mean of the plant's available power is taken over a window centred on t, cut off at
    both ends of the run, and :math:`\lambda` is the share. The paper draws such a profile and gives
    no rule for it: rule and parameters are ours. Under a passing cloud the available power may be
    less than the commitment. This is hindsight: a centred mean knows what the clouds will do.

    share: Share of the mean available power around each moment.
    window_s: Window of that mean [s].
    """

    share: OfClearSky
    window_s: Annotated[float, Meta(gt=0.0, le=86400.0)]


class ScheduledCommitment(_Rule, frozen=True, tag="file"):
    """A schedule in a file.

    path: CSV: time stamps, then the power from then on: `commitment_kw`, or a column in kW or MW.
    """

    path: str


CommitmentSettings: TypeAlias = (
    ConstantCommitment
    | ShareOfMedian
    | ShareOfClearSky
    | BelowAvailable
    | OfferedCommitment
    | ScheduledCommitment
)


def commitment_kw(
    settings: CommitmentSettings,
    times: pd.DatetimeIndex,
    available_kw: Floats,
    clear_sky_kw: Callable[[pd.DatetimeIndex], Floats],
    data_path: Callable[[str], Path],
    timezone: str | None = None,
) -> Floats:
    """Return the committed power of the plant at every time step [kW], shape (T,).

    `available_kw` is the maximum AC power of the whole plant, shape (T,). `clear_sky_kw` returns
    what that would be under a clear sky; it is called only where the rule asks for it. `data_path`
    returns the path of a file that the settings name; `timezone` is that of stamps without an
    offset.
    """
    match settings:
        case ConstantCommitment(power_kw=power_kw):
            return np.full(available_kw.shape, power_kw)
        case ShareOfMedian(share=share):
            median_kw = float(np.median(available_kw))
            if median_kw <= 0.0:
                raise InputError.of(
                    "commitment", "expected a run with daylight for most of its time"
                )
            return np.full(available_kw.shape, share * median_kw)
        case ShareOfClearSky(share=share):
            return share * clear_sky_kw(times)
        case OfferedCommitment(first_share=share):
            return share * clear_sky_kw(times)
        case BelowAvailable(share=share, window_s=window_s):
            # As many values before as after, fewer at the ends.
            half = max(round((window_s / (step_ns(times) / 1e9) - 1.0) / 2.0), 0)
            window = pd.Series(available_kw).rolling(2 * half + 1, min_periods=1, center=True)
            return share * window.mean().to_numpy()
        case ScheduledCommitment(path=path):
            return read_schedule_kw(data_path(path), times, timezone)


def is_hindsight(settings: CommitmentSettings) -> bool:
    """Tell whether a commitment knows what a plant could not."""
    return isinstance(settings, ShareOfMedian | BelowAvailable)


def _power_column(table: CsvTable) -> str:
    """Return the column with the power, whose name or unit says that it is in kW or MW."""
    columns = table.value_columns
    stated = [
        name for name in columns if re.search("[km]w(?!h)", f"{name} {table.units[name]}".lower())
    ]
    found = _COLUMN if _COLUMN in columns else stated[0] if len(stated) == 1 else None
    if found is None:
        raise InputError(
            f"{table.name}: line 1: expected a column {_COLUMN}, or one whose name says kW or MW, "
            f"got {', '.join(columns)}"
        )
    return found


def read_schedule_kw(path: Path, times: pd.DatetimeIndex, timezone: str | None = None) -> Floats:
    """Read a schedule and hold each power until the next [kW], shape (T,).

    The last power holds for as long as the one before it: a file of 24 hourly rows is a day.
    """
    table = read_csv(path)
    column = _power_column(table)
    factor = 1e3 if "mw" in f"{column} {table.units[column]}".lower() else 1.0
    expected = f"a power from 0 to {_LARGEST_KW / factor:g}"
    power_kw = factor * table.numbers((column,), expected, 0.0, _LARGEST_KW / factor)[:, 0]
    table.check_length()
    begins = table.times(timezone)
    late = np.diff(begins.asi8) <= 0
    table.refuse(late, table.stamp, "a time after that of the line before")
    last_ns = (begins[-1] - begins[-2]).value
    check_coverage(f"{path.name}: expected a schedule", begins, last_ns, times)
    held: Floats = power_kw[begins.searchsorted(times, side="right") - 1]
    return held
