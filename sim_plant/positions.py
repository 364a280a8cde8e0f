"""Positions in metres and in degrees. A plant is small: the Earth below it is taken for flat."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

_METRES_PER_DEGREE: Final = 111_200.0
"""Of latitude anywhere, and of longitude on the equator (a sphere of 6,371 km radius)."""


def east_north_m(
    lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions in metres east and north of a point that is the same for all of them.

    Parameters
    ----------
    lat_deg, lon_deg : numpy.ndarray, shape (N,)
        Coordinates [degree], north and east positive.

    Returns
    -------
    east_m, north_m : numpy.ndarray, shape (N,)
    """
    shrink = np.cos(np.radians(lat_deg.mean()))
    return lon_deg * _METRES_PER_DEGREE * shrink, lat_deg * _METRES_PER_DEGREE


def placed_on_the_equator(
    east_m: NDArray[np.float64], north_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return coordinates for a plant of which nobody knows where on Earth it is.

    It comes to lie where the equator meets the meridian of Greenwich: there a degree of longitude
    is as long as one of latitude. The coordinates mean nothing beyond the distances between them.

    Parameters
    ----------
    east_m, north_m : numpy.ndarray, shape (N,)
        Positions [m] from an arbitrary point.

    Returns
    -------
    lat_deg, lon_deg : numpy.ndarray, shape (N,)
        Coordinates [degree].
    """
    lat_deg = (north_m - north_m.mean()) / _METRES_PER_DEGREE
    lon_deg = (east_m - east_m.mean()) / _METRES_PER_DEGREE
    return lat_deg, lon_deg
