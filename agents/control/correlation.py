"""Step 3 of the control algorithm: how alike the power of two inverters behaves, hour by hour.

The paper's equation 5 is Pearson's linear correlation coefficient of two power series. It is kept
here as a covariance matrix first, because a parent higher up the control tree asks whole groups of
inverters: the correlation of two sums follows from the covariance of their members, and not from
their correlation.

A series that does not vary (night, a full curtailment, an inverter at its rating) has no
correlation. It is counted as +1, that is "no evidence that the two differ", so that such a child
is asked last.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# A sum whose variance is below this share of its members' covariances is constant but for
# rounding, e.g. two series that cancel each other.
_CONSTANT_SHARE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class HourlyMatrices:
    """One square matrix for each hour of which there is history.

    Attributes
    ----------
    hours : tuple of int
        The hours, ascending, H of them.
    values : numpy.ndarray, shape (H, N, N)
        The matrix of each hour, in the order of `hours`.
    """

    hours: tuple[int, ...]
    values: NDArray[np.float64]

    def at(self, hour: int) -> NDArray[np.float64]:
        """Return the matrix of one hour.

        Parameters
        ----------
        hour : int
            An hour of `hours`.

        Returns
        -------
        numpy.ndarray, shape (N, N)

        Raises
        ------
        KeyError
            There is no history of that hour.
        """
        if hour not in self.hours:
            raise KeyError(f"no history of hour {hour}; there is history of hours {self.hours}")
        matrix: NDArray[np.float64] = self.values[self.hours.index(hour)]
        return matrix


def hourly_covariance(power_kw: NDArray[np.float64], hour: NDArray[np.integer]) -> HourlyMatrices:
    """Covariance of the power series of all inverters, separately for each hour.

    Parameters
    ----------
    power_kw : numpy.ndarray, shape (T, N)
        Power of each inverter [kW].
    hour : numpy.ndarray of int, shape (T,)
        The hour that each row belongs to, e.g. the local hour of the day 0 to 23. Rows of one
        hour need not follow each other: several days of history may be given at once.

    Returns
    -------
    HourlyMatrices
        Mean product of the deviations from the hour's mean [kW^2]. A series that is constant
        within the hour has a covariance of exactly 0 with all others.

    Raises
    ------
    ValueError
        The shapes do not fit, there is no row, or a power is not finite.
    """
    power = np.asarray(power_kw, dtype=np.float64)
    hours = np.asarray(hour)
    _check_history(power, hours)
    found = np.unique(hours)
    values = np.stack([_covariance(power[hours == h]) for h in found])
    return HourlyMatrices(tuple(int(h) for h in found), values)


def hourly_correlation(power_kw: NDArray[np.float64], hour: NDArray[np.integer]) -> HourlyMatrices:
    r"""Pearson correlation of all inverters, separately for each hour (paper, eq. 5).

    .. math::

        C(X,Y) = \frac{\sum_i (X_i-\bar X)(Y_i-\bar Y)}
                      {\sqrt{\sum_i (X_i-\bar X)^2 \sum_i (Y_i-\bar Y)^2}}

    Parameters
    ----------
    power_kw : numpy.ndarray, shape (T, N)
        Power of each inverter [kW].
    hour : numpy.ndarray of int, shape (T,)
        The hour that each row belongs to.

    Returns
    -------
    HourlyMatrices
        Correlations in [-1, 1], symmetric, with a diagonal of exactly 1. Where one of two series
        is constant within the hour the entry is +1.

    Raises
    ------
    ValueError
        As in `hourly_covariance`.
    """
    covariance = hourly_covariance(power_kw, hour)
    singles = [(i,) for i in range(covariance.values.shape[1])]
    values = np.stack([group_correlation(matrix, singles) for matrix in covariance.values])
    return HourlyMatrices(covariance.hours, values)


def group_correlation(
    covariance: NDArray[np.float64], groups: Sequence[Sequence[int]]
) -> NDArray[np.float64]:
    """Pearson correlation of the summed power of groups of inverters.

    The children of a supervisor are inverters (groups of one), those of the central controller
    are clusters, and so on at every further tier: the power of a child is the sum of its members.

    Parameters
    ----------
    covariance : numpy.ndarray, shape (N, N)
        Covariance of the single inverters [kW^2], e.g. one of `hourly_covariance`.
    groups : sequence of sequence of int
        The members of each of the G groups, as indices into `covariance`.

    Returns
    -------
    numpy.ndarray, shape (G, G)
        Correlations in [-1, 1], symmetric, with a diagonal of exactly 1. Where one of two sums
        does not vary the entry is +1.

    Raises
    ------
    ValueError
        The covariance is not square, a group is empty, or a member is not an index of it.
    """
    member = _membership(covariance, groups)
    between = member.T @ covariance @ member
    variance = np.diag(between)
    scale = np.diag(member.T @ np.abs(covariance) @ member)
    constant = variance <= _CONSTANT_SHARE * scale
    deviation = np.sqrt(np.where(constant, 1.0, variance))
    correlation = np.clip(between / np.outer(deviation, deviation), -1.0, 1.0)
    correlation[constant, :] = 1.0
    correlation[:, constant] = 1.0
    np.fill_diagonal(correlation, 1.0)
    return np.asarray((correlation + correlation.T) / 2.0)


def _covariance(power_kw: NDArray[np.float64]) -> NDArray[np.float64]:
    deviation = power_kw - power_kw.mean(axis=0)
    # The mean of equal numbers is not always that number: rounding must not look like variance.
    deviation[:, np.ptp(power_kw, axis=0) == 0.0] = 0.0
    product: NDArray[np.float64] = deviation.T @ deviation / len(power_kw)
    return product


def _membership(
    covariance: NDArray[np.float64], groups: Sequence[Sequence[int]]
) -> NDArray[np.float64]:
    size = covariance.shape[0]
    if covariance.shape != (size, size):
        raise ValueError(f"the covariance must be square, not of shape {covariance.shape}")
    member = np.zeros((size, len(groups)))
    for column, group in enumerate(groups):
        if not group or min(group) < 0 or max(group) >= size:
            raise ValueError(f"group {column} is {tuple(group)}, expected members 0 to {size - 1}")
        member[list(group), column] = 1.0
    return member


def _check_history(power_kw: NDArray[np.float64], hour: NDArray[np.integer]) -> None:
    if power_kw.ndim != 2 or hour.shape != power_kw.shape[:1] or power_kw.size == 0:
        raise ValueError(
            f"power of shape (T, N) and hours of shape (T,) are needed,"
            f" not {power_kw.shape} and {hour.shape}"
        )
    if not np.isfinite(power_kw).all():
        row, column = np.argwhere(~np.isfinite(power_kw))[0]
        raise ValueError(
            f"power {power_kw[row, column]} in row {row}, column {column} is not finite"
        )
