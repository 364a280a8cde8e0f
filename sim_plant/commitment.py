"""The commitment: the power that the plant has promised to deliver, at every time step."""

from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from bus_schemas.errors import InputError

Share = Annotated[float, msgspec.Meta(gt=0.0, le=1.2)]


class ConstantCommitment(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="constant"
):
    """The same power at every time step.

    Attributes
    ----------
    power_kw : float
        The committed power [kW], at least 0.
    """

    power_kw: Annotated[float, msgspec.Meta(ge=0.0, le=1e8)]


class ShareOfMedian(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", tag="share-of-median"
):
    """A share of the plant's median possible power in the run, the same at every time step.

    This is hindsight: the median is known only after the run. It serves to compare control
    schemes at a like difficulty on different days, not as a bid that a plant could have made.

    Attributes
    ----------
    share : float
        Above 0, at most 1.2.
    """

    share: Share


class ShareOfClearSky(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    tag="share-of-clear-sky",
):
    """A share of the power that the plant would have under a clear sky, known in advance.

    Attributes
    ----------
    share : float
        Above 0, at most 1.2.
    """

    share: Share


CommitmentSettings = ConstantCommitment | ShareOfMedian | ShareOfClearSky


def commitment_kw(
    settings: CommitmentSettings,
    possible_kw: NDArray[np.float64],
    clear_sky_kw: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the committed power of the plant at every time step.

    Parameters
    ----------
    settings : ConstantCommitment, ShareOfMedian or ShareOfClearSky
        Which rule applies.
    possible_kw : numpy.ndarray, shape (T,)
        Maximum AC power of the whole plant at every time step of the run [kW].
    clear_sky_kw : numpy.ndarray, shape (T,)
        AC power that the whole plant would have under a clear sky [kW].

    Returns
    -------
    numpy.ndarray, shape (T,)
        Committed power [kW], never negative.

    Raises
    ------
    InputError
        The median possible power of the run is 0, so that a share of it would commit to nothing.
    ValueError
        The two series are not of one length.
    """
    if possible_kw.ndim != 1 or possible_kw.shape != clear_sky_kw.shape:
        raise ValueError(
            f"two series of shape (T,) are needed, not {possible_kw.shape} and {clear_sky_kw.shape}"
        )
    if isinstance(settings, ConstantCommitment):
        return np.full(possible_kw.shape, settings.power_kw)
    if isinstance(settings, ShareOfMedian):
        return np.full(possible_kw.shape, settings.share * _median_kw(possible_kw))
    return settings.share * clear_sky_kw


def _median_kw(possible_kw: NDArray[np.float64]) -> float:
    median = float(np.median(possible_kw))
    if not median > 0.0:
        raise InputError(
            f"commitment: the median possible power of the run is {median:g} kW;"
            " share-of-median accepts a run that is in daylight for more than half of its time"
        )
    return median
