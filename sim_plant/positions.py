"""Positions in metres and in degrees. A plant is small: the Earth below it is taken for flat."""

from typing import Final

import numpy as np

from sim_plant import Floats

_METRES_PER_DEGREE: Final = np.deg2rad(1.0) * 6_371_000.0
"""Of latitude anywhere, and of longitude on the equator."""


def east_north_m(lat_deg: Floats, lon_deg: Floats) -> tuple[Floats, Floats]:
    """Return metres east and north of the middle of all places."""
    shrink = np.cos(np.deg2rad(lat_deg.mean()))
    east_m = (lon_deg - lon_deg.mean()) * _METRES_PER_DEGREE * shrink
    return east_m, (lat_deg - lat_deg.mean()) * _METRES_PER_DEGREE


def placed_on_the_equator(east_m: Floats, north_m: Floats) -> tuple[Floats, Floats]:
    """Return latitudes and longitudes for a plant of which nobody knows where on Earth it is.

    On the equator a degree of longitude is as long as one of latitude.
    """
    return (
        (north_m - north_m.mean()) / _METRES_PER_DEGREE,
        (east_m - east_m.mean()) / _METRES_PER_DEGREE,
    )
