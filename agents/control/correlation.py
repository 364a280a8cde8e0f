"""Step 3 of the control algorithm: how alike the power of two inverters behaves, hour by hour.

The paper's equation 5 is Pearson's linear correlation coefficient of two power series. The past is
kept as each inverter's deviations from its mean: those of a cluster are the sums of its members'.

A series that does not vary (night, an inverter at its rating) has no correlation. It is counted as
+1, "no evidence that the two differ", so that such a child is asked last.
"""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

HourlyMatrices: TypeAlias = dict[int, NDArray[np.float64]]
"""A matrix with a column for each inverter, for each hour with history, the hours ascending."""

# A sum whose variance is below this share of what its members could add up to is constant but for
# rounding, e.g. two series that cancel each other.
_CONSTANT_SHARE = 1e-12


def hourly_deviations(power_kw: NDArray[np.float64], hour: NDArray[np.integer]) -> HourlyMatrices:
    """Deviations of the power of all inverters from their means in each hour.

    Parameters
    ----------
    power_kw : numpy.ndarray, shape (T, N)
        Power of each inverter [kW].
    hour : numpy.ndarray of int, shape (T,)
        The hour that each row belongs to, e.g. the local hour of the day, of one or several days.

    Returns
    -------
    HourlyMatrices
        One row for each of the hour's rows [kW].
    """
    return {each: _deviations(power_kw[hour == each]) for each in np.unique(hour).tolist()}


def hourly_correlation(power_kw: NDArray[np.float64], hour: NDArray[np.integer]) -> HourlyMatrices:
    r"""Pearson correlation of all inverters, separately for each hour (paper, eq. 5).

    .. math::

        C(X,Y) = \frac{\sum_i (X_i-\bar X)(Y_i-\bar Y)}
                      {\sqrt{\sum_i (X_i-\bar X)^2 \sum_i (Y_i-\bar Y)^2}}

    The parameters are those of `hourly_deviations`.
    """
    singles = [(inverter,) for inverter in range(power_kw.shape[1])]
    deviations = hourly_deviations(power_kw, hour)
    return {each: group_correlation(matrix, singles) for each, matrix in deviations.items()}


def group_correlation(
    deviations_kw: NDArray[np.float64], groups: Sequence[Sequence[int]]
) -> NDArray[np.float64]:
    """Pearson correlation of the summed power of groups of inverters.

    Parameters
    ----------
    deviations_kw : numpy.ndarray, shape (T, N)
        Deviations of the single inverters from their means [kW].
    groups : sequence of sequence of int
        The members of each of the G groups, as columns of `deviations_kw`.

    Returns
    -------
    numpy.ndarray, shape (G, G)
        Correlations in [-1, 1], symmetric, with a diagonal of exactly 1.
    """
    members = [deviations_kw[:, list(group)] for group in groups]
    sums = np.column_stack([one.sum(axis=1) for one in members])
    between = sums.T @ sums / len(sums)
    variance = np.diag(between)
    # Most that the variance of a sum can be: that of members that all vary together.
    most = np.array([np.sqrt(np.mean(one**2, axis=0)).sum() ** 2 for one in members])
    constant = variance <= _CONSTANT_SHARE * most
    deviation = np.sqrt(np.where(constant, 1.0, variance))
    correlation = np.clip(between / np.outer(deviation, deviation), -1.0, 1.0)
    correlation[constant, :] = 1.0
    correlation[:, constant] = 1.0
    np.fill_diagonal(correlation, 1.0)
    return np.asarray((correlation + correlation.T) / 2.0)


def _deviations(power_kw: NDArray[np.float64]) -> NDArray[np.float64]:
    deviation: NDArray[np.float64] = power_kw - power_kw.mean(axis=0)
    # The mean of equal numbers is not always that number: rounding must not look like variance.
    deviation[:, np.ptp(power_kw, axis=0) == 0.0] = 0.0
    return deviation
