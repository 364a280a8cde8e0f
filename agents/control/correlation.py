"""Step 3 of the control algorithm: how alike the power of two inverters behaves, hour by hour.

The paper's equation 5 is Pearson's linear correlation coefficient of two power series. It is kept
here as a covariance matrix first: the correlation of two sums, such as those of clusters, follows
from the covariance of their members, and not from their correlation.

A series that does not vary (night, an inverter at its rating) has no correlation. It is counted as
+1, "no evidence that the two differ", so that such a child is asked last.
"""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

HourlyMatrices: TypeAlias = dict[int, NDArray[np.float64]]
"""A square matrix, shape (N, N), for each hour of which there is history, the hours ascending."""

# A sum whose variance is below this share of its members' covariances is constant but for
# rounding, e.g. two series that cancel each other.
_CONSTANT_SHARE = 1e-12


def hourly_covariance(power_kw: NDArray[np.float64], hour: NDArray[np.integer]) -> HourlyMatrices:
    """Covariance of the power series of all inverters, separately for each hour.

    Parameters
    ----------
    power_kw : numpy.ndarray, shape (T, N)
        Power of each inverter [kW].
    hour : numpy.ndarray of int, shape (T,)
        The hour that each row belongs to, e.g. the local hour of the day, of one or several days.

    Returns
    -------
    HourlyMatrices
        Mean product of the deviations from the hour's mean [kW^2].
    """
    return {each: _covariance(power_kw[hour == each]) for each in np.unique(hour).tolist()}


def hourly_correlation(power_kw: NDArray[np.float64], hour: NDArray[np.integer]) -> HourlyMatrices:
    r"""Pearson correlation of all inverters, separately for each hour (paper, eq. 5).

    .. math::

        C(X,Y) = \frac{\sum_i (X_i-\bar X)(Y_i-\bar Y)}
                      {\sqrt{\sum_i (X_i-\bar X)^2 \sum_i (Y_i-\bar Y)^2}}

    The parameters are those of `hourly_covariance`.
    """
    singles = [(inverter,) for inverter in range(power_kw.shape[1])]
    covariance = hourly_covariance(power_kw, hour)
    return {each: group_correlation(matrix, singles) for each, matrix in covariance.items()}


def group_correlation(
    covariance: NDArray[np.float64], groups: Sequence[Sequence[int]]
) -> NDArray[np.float64]:
    """Pearson correlation of the summed power of groups of inverters.

    Parameters
    ----------
    covariance : numpy.ndarray, shape (N, N)
        Covariance of the single inverters [kW^2].
    groups : sequence of sequence of int
        The members of each of the G groups, as indices into `covariance`.

    Returns
    -------
    numpy.ndarray, shape (G, G)
        Correlations in [-1, 1], symmetric, with a diagonal of exactly 1.
    """
    member = np.zeros((len(covariance), len(groups)))
    for column, group in enumerate(groups):
        member[list(group), column] = 1.0
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
