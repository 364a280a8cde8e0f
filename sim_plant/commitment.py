"""The commitment: the power that the plant has promised to deliver, at every time step."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeAlias

import msgspec
import numpy as np
import pandas as pd
from msgspec import Meta
from numpy.typing import NDArray

from bus_schemas.errors import InputError
from sim_plant.csv_tables import check_increasing, read_csv
from sim_plant.time_steps import step_ns

_LARGEST_KW = 1e8
_COLUMN = "commitment_kw"

Power = Annotated[float, Meta(ge=0.0, le=_LARGEST_KW)]
Share = Annotated[float, Meta(gt=0.0, le=1.2)]
Window = Annotated[float, Meta(gt=0.0, le=86400.0)]


class _Rule(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind"):
    """How the commitment is made."""


class ConstantCommitment(_Rule, frozen=True, tag="constant"):
    """The same power at every time step."""

    power_kw: Annotated[Power, Meta(description="The committed power [kW].")]


class ShareOfMedian(_Rule, frozen=True, tag="share-of-median"):
    """A share of the plant's median possible power in the run, the same at every time step.

    This is hindsight: the median is known only after the run. It serves to compare control
    schemes at a like difficulty on different days, not as a bid that a plant could have made.
    """

    share: Annotated[Share, Meta(description="Share of the median.")]


class ShareOfClearSky(_Rule, frozen=True, tag="share-of-clear-sky"):
    """A share of the power that the plant would have under a clear sky, known in advance."""

    share: Annotated[Share, Meta(description="Share of the clear-sky power.")]


class BelowPossible(_Rule, frozen=True, tag="below-possible"):
    r"""A smooth profile below the possible power, as in the paper's case study.

    .. math:: P_{com}(t) = \lambda \, \overline{P_{MPP}}(t)

    where the mean of the plant's possible power is taken over a window centred on t, cut off at
    both ends of the run, and :math:`\lambda` is the share. The paper draws such a profile (its
    figure of the uncurtailed power) and gives no rule for it: rule and parameters are ours. Under a
    passing cloud the possible power may be less than the commitment.

    This is hindsight: a centred mean knows what the clouds are going to do. It is not a bid that
    a plant could have made.
    """

    share: Annotated[
        Share, Meta(description="Share of the mean possible power around each moment.")
    ]
    window_s: Annotated[Window, Meta(description="Length of the window of that mean [s].")]


class ScheduledCommitment(_Rule, frozen=True, tag="file"):
    """A schedule in a file."""

    path: Annotated[
        str, Meta(description="CSV: ISO 8601 time stamps first, `commitment_kw` from then on [kW].")
    ]


CommitmentSettings: TypeAlias = (
    ConstantCommitment | ShareOfMedian | ShareOfClearSky | BelowPossible | ScheduledCommitment
)


def commitment_kw(
    settings: CommitmentSettings,
    times: pd.DatetimeIndex,
    possible_kw: NDArray[np.float64],
    clear_sky_kw: Callable[[pd.DatetimeIndex], NDArray[np.float64]],
    data_path: Callable[[str], Path],
) -> NDArray[np.float64]:
    """Return the committed power of the plant at every time step.

    Parameters
    ----------
    settings : ConstantCommitment, ShareOfMedian, ShareOfClearSky, BelowPossible or \
    ScheduledCommitment
        Which rule applies.
    times : pandas.DatetimeIndex, length T
        The time steps of the run.
    possible_kw : numpy.ndarray, shape (T,)
        Maximum AC power of the whole plant at every time step of the run [kW].
    clear_sky_kw : callable
        Returns the AC power that the whole plant would have under a clear sky [kW], shape (T,).
        It is called only where the rule asks for it: not every plant's place is known.
    data_path : callable
        Returns the path of a file that the settings name.

    Returns
    -------
    numpy.ndarray, shape (T,)
        Committed power [kW], never negative.

    Raises
    ------
    InputError
        The median possible power of the run is 0, so that a share of it would commit to nothing;
        a schedule cannot be used or does not cover the run.
    ValueError
        The possible power is not of the length of the times.
    """
    if possible_kw.shape != (len(times),):
        raise ValueError(f"a series of shape ({len(times)},) is needed, not {possible_kw.shape}")
    match settings:
        case ConstantCommitment(power_kw=power_kw):
            return np.full(possible_kw.shape, power_kw)
        case ShareOfMedian(share=share):
            return np.full(possible_kw.shape, share * _median_kw(possible_kw))
        case ShareOfClearSky(share=share):
            return share * clear_sky_kw(times)
        case BelowPossible(share=share, window_s=window_s):
            return share * _centred_mean(possible_kw, window_s / (step_ns(times) / 1e9))
        case ScheduledCommitment(path=path):
            return read_schedule_kw(data_path(path), times)


def hindsight(settings: CommitmentSettings) -> str | None:
    """Say what a commitment knows that a plant could not; None if a plant could have made it."""
    match settings:
        case ShareOfMedian(share=share):
            return f"The commitment is {share:g} of the run's own median possible power: hindsight."
        case BelowPossible(share=share, window_s=window_s):
            return (
                f"The commitment is {share:g} of the run's own possible power, in a centred mean"
                f" over {window_s:g} s: hindsight."
            )
        case _:
            return None


def read_schedule_kw(path: Path, times: pd.DatetimeIndex) -> NDArray[np.float64]:
    """Read a schedule and hold each power until the next.

    The last power holds for as long as the one before it: a file of 24 hourly rows is a day.

    Parameters
    ----------
    path : pathlib.Path
        The CSV file.
    times : pandas.DatetimeIndex, length T
        The time steps of the run.

    Returns
    -------
    numpy.ndarray, shape (T,)
        Committed power at the beginning of each time step [kW].

    Raises
    ------
    InputError
        The file is not as described, a power is not from 0 to 1e8 kW, time stamps do not
        increase, or the schedule does not cover the run.
    """
    table = read_csv(path)
    table.check_header((_COLUMN,))
    expected = f"a power from 0 to {_LARGEST_KW:g} kW"
    power_kw = table.numbers((_COLUMN,), expected, 0.0, _LARGEST_KW)[:, 0]
    stamp = table.header[0]
    begins = table.times(stamp)
    check_increasing(begins.asi8, lambda row, wanted: table.error(row, stamp, wanted))
    ends = begins[-1] + (begins[-1] - begins[-2])
    run_ends = times[-1] + pd.Timedelta(step_ns(times), unit="ns")
    if times[0] < begins[0] or run_ends > ends:
        raise InputError(
            f"{path.name}: expected a schedule of the run, {_utc(times[0])} to {_utc(run_ends)}, "
            f"got {_utc(begins[0])} to {_utc(ends)}"
        )
    held: NDArray[np.float64] = power_kw[begins.searchsorted(times, side="right") - 1]
    return held


def _median_kw(possible_kw: NDArray[np.float64]) -> float:
    median = float(np.median(possible_kw))
    if not median > 0.0:
        raise InputError(
            "commitment: expected a run with daylight for more than half of its time, got a median "
            f"possible power of {median:g} kW"
        )
    return median


def _centred_mean(series: NDArray[np.float64], window: float) -> NDArray[np.float64]:
    """Mean over as many values before as after, fewer at the ends."""
    half = round((window - 1.0) / 2.0) if window > 1.0 else 0
    row = np.arange(len(series))
    first = np.maximum(row - half, 0)
    after = np.minimum(row + half + 1, len(series))
    total = np.concatenate([[0.0], np.cumsum(series)])
    mean: NDArray[np.float64] = (total[after] - total[first]) / (after - first)
    # Differences of sums round: a mean of powers is none below zero.
    return np.maximum(mean, 0.0)


def _utc(time: pd.Timestamp) -> str:
    return time.tz_convert("UTC").isoformat().replace("+00:00", "Z")
