"""Synthetic irradiance: a field of broken clouds that drifts over the plant.

Clear-sky GHI is multiplied by a clear-sky index that is read, for each sensor and time stamp, from
a two-dimensional random field. The field moves over the true coordinates of the sensors, so that
they see the same cloud one after the other, and changes its shape slowly while it does.

With p the position of a sensor [m], v the drift velocity [m/s] and t the seconds since a fixed
epoch (so that the weather at an instant does not depend on where a run begins):

1. A and B are independent Gaussian random fields with zero mean, unit variance and the isotropic
   power spectrum ``(1 + (k / k0)^2)^(-5/3) exp(-(k l)^2)`` with ``k0 = 1 / cloud size``: flat for
   scales larger than a cloud and its gap, a power law below, smooth within ``l = 20 m`` (a sensor
   sees the half shadow of an edge and the light of a part of the sky). They are periodic, so that
   the clouds never run out.
2. ``f = A(p - v t) cos(phi) + B(p - v t) sin(phi)`` with ``phi = pi t / (2 evolution time)``: after
   one evolution time the clouds of before are gone, and the statistics are the same. (After two
   of them the field is its own negative, after four itself; it has drifted on by then.)
3. Where f exceeds the quantile that leaves the wanted share of the sky covered, there is cloud.
   With s the excess over that quantile, the clear-sky index falls from the edge into the cloud,
   and is raised beside the edge by the light that the cloud scatters:
   ``thick + (1 - thick) exp(-softplus(s) / 0.5) + (enhancement - 1) exp(-(s + 0.3)^2 / 0.18)``,
   where ``softplus(s) = 0.08 log(1 + exp(s / 0.08))`` is max(s, 0) with its corner rounded.

To draw clouds from a random field with a power-law spectrum that drifts with the wind is the idea
of Beyer, Hammer, Luther et al., "Analysis and synthesis of cloud pattern for radiation field
studies", Solar Energy 52 (1994). The formulas are this project's own; their constants were set
beside 1 s measurements under broken clouds (HOPE-Melpitz, doi:10.5194/amt-9-1153-2016).
"""

from typing import Annotated

import msgspec
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pvlib.location import Location
from scipy import fft, ndimage, special

_EARTH_RADIUS_M = 6_371_000.0

# 2048 cells of at least 10 m: a torus at least 20 km wide, and at least 20 clouds wide.
_CELLS = 2048
_LEAST_CELL_M = 10.0
_CLOUDS_ACROSS = 20.0

# Constants of steps 1 and 3; the last four in units of the field's standard deviation.
_SPECTRUM_EXPONENT = -5.0 / 3.0
_SMOOTHING_M = 20.0
_CORNER = 0.08
_EDGE = 0.5
_HALO_CENTRE = -0.3
_HALO_WIDTH = 0.3

# The torus is turned against the drift by the slope of the golden ratio, which no fraction
# approximates well: a track that leaves one side comes back far from where it passed before.
_TRACK_SLOPE = (np.sqrt(5.0) - 1.0) / 2.0


class CloudSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The sky. The defaults are broken trade-wind cumulus over Oahu.

    Attributes
    ----------
    cloud_cover : float, default 0.45
        Share of the sky that clouds cover, on the average over hours; 0 is a clear sky.
    drift_speed_ms : float, default 10
        Speed of the clouds [m/s].
    drift_from_deg : float, default 65
        Where the clouds come from, clockwise from north [degree], as a wind direction is given.
    cloud_size_m : float, default 800
        Size of a typical cloud [m]; the gaps between clouds follow from the cover.
    thick_cloud_index : float, default 0.25
        Clear-sky index under the thickest cloud.
    edge_enhancement : float, default 1.15
        Highest clear-sky index, close beside a cloud; 1 is without enhancement.
    evolution_s : float, default 1200
        Time after which the shapes of the clouds have entirely changed [s].
    linke_turbidity : float, default 3
        Linke turbidity of the clear sky.
    """

    cloud_cover: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.45
    drift_speed_ms: Annotated[float, msgspec.Meta(ge=0.0, le=60.0)] = 10.0
    drift_from_deg: Annotated[float, msgspec.Meta(ge=0.0, le=360.0)] = 65.0
    cloud_size_m: Annotated[float, msgspec.Meta(ge=50.0, le=20_000.0)] = 800.0
    thick_cloud_index: Annotated[float, msgspec.Meta(ge=0.05, le=1.0)] = 0.25
    edge_enhancement: Annotated[float, msgspec.Meta(ge=1.0, le=1.4)] = 1.15
    evolution_s: Annotated[float, msgspec.Meta(ge=60.0, le=86_400.0)] = 1200.0
    linke_turbidity: Annotated[float, msgspec.Meta(ge=1.0, le=10.0)] = 3.0


def clear_sky_ghi(
    times: pd.DatetimeIndex,
    lat_deg: NDArray[np.float64],
    lon_deg: NDArray[np.float64],
    altitude_m: float,
    linke_turbidity: float,
) -> NDArray[np.float64]:
    """Return the clear-sky GHI at the centroid of the plant.

    The model is that of Ineichen and Perez as pvlib has it (doi:10.1016/S0038-092X(02)00045-2).

    Parameters
    ----------
    times : pandas.DatetimeIndex, length T
        Time stamps with a time zone.
    lat_deg, lon_deg : numpy.ndarray, shape (N,)
        Coordinates of the sensors [degree], north and east positive.
    altitude_m : float
        Altitude of the plant above the sea [m].
    linke_turbidity : float
        Linke turbidity.

    Returns
    -------
    numpy.ndarray, shape (T,)
        GHI [W/m^2], 0 at night.
    """
    site = Location(float(lat_deg.mean()), float(lon_deg.mean()), altitude=altitude_m)
    sky = site.get_clearsky(times, model="ineichen", linke_turbidity=linke_turbidity)
    return np.asarray(sky["ghi"].to_numpy(), dtype=np.float64)


def synthetic_ghi(
    times: pd.DatetimeIndex,
    lat_deg: NDArray[np.float64],
    lon_deg: NDArray[np.float64],
    altitude_m: float,
    settings: CloudSettings,
    seed: int,
) -> NDArray[np.float64]:
    """Draw the GHI at each sensor under drifting synthetic clouds.

    The value at an instant depends on the instant, the sensors, the settings and the seed, not on
    the other time stamps: a run from 12:00 sees the weather that one from 11:00 sees at 12:00.

    Parameters
    ----------
    times : pandas.DatetimeIndex, length T
        Time stamps with a time zone.
    lat_deg, lon_deg : numpy.ndarray, shape (N,)
        Coordinates of the sensors [degree], north and east positive.
    altitude_m : float
        Altitude of the plant above the sea [m].
    settings : CloudSettings
        The sky.
    seed : int
        Seed of the cloud field, at least 0.

    Returns
    -------
    numpy.ndarray, shape (T, N)
        GHI [W/m^2], never negative, 0 at night.
    """
    clear_wm2 = clear_sky_ghi(times, lat_deg, lon_deg, altitude_m, settings.linke_turbidity)
    time_s = _seconds_since_epoch(times)
    cell_m = max(_LEAST_CELL_M, settings.cloud_size_m * _CLOUDS_ACROSS / _CELLS)
    cells = _torus_cells(time_s, *_local_metres(lat_deg, lon_deg), settings, cell_m)
    first, second = (
        ndimage.map_coordinates(field, cells, order=1, mode="grid-wrap")
        for field in _two_fields(settings.cloud_size_m, cell_m, seed)
    )
    phase = (0.5 * np.pi * time_s / settings.evolution_s)[:, None]
    excess = (
        first * np.cos(phase) + second * np.sin(phase) - special.ndtri(1 - settings.cloud_cover)
    )
    return clear_wm2[:, None] * _clear_sky_index(excess, settings)


def _clear_sky_index(excess: NDArray[np.float64], settings: CloudSettings) -> NDArray[np.float64]:
    """Step 3 of the model: from the excess over the threshold to the clear-sky index."""
    thick = settings.thick_cloud_index
    depth = _CORNER * np.logaddexp(0.0, excess / _CORNER)
    transmitted = thick + (1.0 - thick) * np.exp(-depth / _EDGE)
    halo = np.exp(-0.5 * ((excess - _HALO_CENTRE) / _HALO_WIDTH) ** 2)
    return np.asarray(transmitted + (settings.edge_enhancement - 1.0) * halo)


def _two_fields(
    cloud_size_m: float, cell_m: float, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Step 1 of the model: two independent random fields of zero mean and unit variance."""
    rng = np.random.default_rng(seed)
    amplitude = _spectrum_amplitude(cloud_size_m, cell_m)
    first, second = (_standardised(_random_field(rng, amplitude)) for _ in range(2))
    # What two samples have in common by chance would make the variance of their mix pulsate.
    second = _standardised(second - np.mean(first * second) * first)
    return first, second


def _random_field(rng: np.random.Generator, amplitude: NDArray[np.float32]) -> NDArray[np.float32]:
    noise = rng.standard_normal((_CELLS, _CELLS), dtype=np.float32)
    return np.asarray(fft.irfft2(fft.rfft2(noise) * amplitude, s=noise.shape))


def _spectrum_amplitude(cloud_size_m: float, cell_m: float) -> NDArray[np.float32]:
    k_y = 2.0 * np.pi * fft.fftfreq(_CELLS, cell_m)[:, None]
    k_x = 2.0 * np.pi * fft.rfftfreq(_CELLS, cell_m)[None, :]
    k_squared = k_x**2 + k_y**2
    power = (1.0 + k_squared * cloud_size_m**2) ** _SPECTRUM_EXPONENT
    amplitude = np.sqrt(power * np.exp(-k_squared * _SMOOTHING_M**2))
    return amplitude.astype(np.float32)


def _standardised(field: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray((field - field.mean()) / field.std(), dtype=np.float32)


def _torus_cells(
    time_s: NDArray[np.float64],
    east_m: NDArray[np.float64],
    north_m: NDArray[np.float64],
    settings: CloudSettings,
    cell_m: float,
) -> NDArray[np.float64]:
    """Where each sensor is at each time in the field that drifts, in cells, shape (2, T, N)."""
    origin = np.deg2rad(settings.drift_from_deg)
    towards_east, towards_north = -np.sin(origin), -np.cos(origin)
    along = (east_m * towards_east + north_m * towards_north)[None, :]
    along = along - settings.drift_speed_ms * time_s[:, None]
    across = np.broadcast_to(north_m * towards_east - east_m * towards_north, along.shape)
    turn = np.arctan(_TRACK_SLOPE)
    x = along * np.cos(turn) - across * np.sin(turn)
    y = along * np.sin(turn) + across * np.cos(turn)
    # Modulo here, since single cells are lost in the rounding of coordinates of 1e9 cells.
    return np.stack([y, x]) / cell_m % _CELLS


def _local_metres(
    lat_deg: NDArray[np.float64], lon_deg: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Metres east and north of the centroid; a plant is small enough to be flat."""
    degree_m = np.deg2rad(1.0) * _EARTH_RADIUS_M
    centre_deg = lat_deg.mean()
    east_m = (lon_deg - lon_deg.mean()) * degree_m * np.cos(np.deg2rad(centre_deg))
    return east_m, (lat_deg - centre_deg) * degree_m


def _seconds_since_epoch(times: pd.DatetimeIndex) -> NDArray[np.float64]:
    return np.asarray((times - pd.Timestamp(0, tz="UTC")).total_seconds(), dtype=np.float64)
