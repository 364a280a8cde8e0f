"""Synthetic irradiance: a field of broken clouds that drifts over the plant.

Clear-sky GHI is multiplied by a clear-sky index that is read, for each sensor and time stamp, from
a two-dimensional random field. The field moves over the true coordinates of the sensors, so that
they see the same cloud one after the other, and changes its shape while it does.

With p the position of a sensor [m], v the drift velocity [m/s] and t the seconds since a fixed
epoch (so that the weather at an instant does not depend on where a run begins):

1. f is a Gaussian random field with zero mean, unit variance and the power spectrum
   ``(1 + (k L)^2)^(-5/4) exp(-(k l)^2)``: flat above the outer scale ``L = 14 cloud sizes``, for
   clouds come in groups; below it a power law, -3/2 along a line and so -5/2 in the plane, a little
   less steep than the -5/3 that turbulence gives to what it mixes [1]_, as it was measured under
   broken clouds [2]_; smooth within ``l = 25 m``, for a sensor sees the half shadow of an edge and
   the light of a part of the sky. Distances across the drift count 1.5 times, so clouds are 1.5
   times as long along the wind as across it.
2. f is the sum of a coarse and a fine layer, which take the shares ``exp(-(k c)^2)`` and
   ``1 - exp(-(k c)^2)`` of that power, ``c = 500 m`` being how far around a sensor clouds lend it
   light. Each layer is periodic, so that the clouds never run out, and blends from one piece of
   sky into the next: ``F(p - v t + o_j) cos(phi) + F(p - v t + o_(j+1)) sin(phi)`` with
   ``t / lifetime = j + 2 phi / pi`` and offsets o_j far from each other. Coarse structures live for
   the evolution time; fine ones, of the size ``d = c / 2``, for ``(d / L)^(2/3)`` of it, as eddies
   do in turbulence.
3. With s the excess of f over the quantile that leaves the wanted share of the sky covered, and n
   the share of cloud to be expected around the sensor, which the coarse layer tells, the clear-sky
   index is ``thick + (1 - thick) T + (enhancement - 1) 4 n (1 - n) T``. The sunlight that comes
   through, ``T = exp(-softplus(s / softness + 0.3))`` with a rounded corner, falls from the edge
   into the cloud. The last term is light that clouds around scatter into the sun: most under
   broken clouds, none under a clear sky. Measured sunlit indices lie above 1 in the whole gap
   between clouds and not only beside an edge [3]_.

To draw clouds from a random field with a power-law spectrum that drifts with the wind is the idea
of [4]_; a later model with cloud edges of fractal dimension 1.5 met the correlations of 99
pyranometers [5]_. The formulas here are the project's own. ``docs/clouds.md`` says by which
measurements their constants were set, and by which others they were checked.

.. [1] S. Corrsin, "On the spectrum of isotropic temperature fluctuations in an isotropic
   turbulence", J. Appl. Phys. 22 (1951), doi:10.1063/1.1699986
.. [2] G. M. Lewis, P. H. Austin, M. Szczodrak, "Spatial statistics of marine boundary layer
   clouds", J. Geophys. Res. 109 (2004), doi:10.1029/2003JD003742: optical depth, from 28.5 m on
.. [3] Z. He et al., "Combining observations and simulations to investigate the small-scale
   variability of surface solar irradiance under continental cumulus clouds", Atmos. Chem. Phys. 24
   (2024), doi:10.5194/acp-24-11391-2024
.. [4] H. G. Beyer, A. Hammer, J. Luther et al., "Analysis and synthesis of cloud pattern for
   radiation field studies", Solar Energy 52 (1994)
.. [5] G. M. Lohmann et al., "Simulating clear-sky index increment correlations under mixed sky
   conditions using a fractal cloud model", Solar Energy 150 (2017)
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Annotated, Final

import msgspec
import numpy as np
import pandas as pd
import scipy
from msgspec import Meta
from numpy.typing import NDArray

from sim_plant import Floats, imported_when_used
from sim_plant.sites import east_north_m

pvlib = imported_when_used("pvlib")

# Constants of steps 1 and 2.
_OUTER_SCALE = 14.0
_SPECTRUM_EXPONENT = -5.0 / 4.0
_SMOOTHING_M = 25.0
_STRETCH = 1.5
_NEIGHBOURHOOD_M = 500.0

# The torus of the coarse layer is 20 outer scales wide, that of the fine one 40 neighbourhoods.
_COARSE_CELLS = 1024
_FINE_CELLS = 2048
_OUTER_SCALES_ACROSS = 20.0
_NEIGHBOURHOODS_ACROSS = 40.0
_LEAST_COARSE_CELL_M = 50.0
_LEAST_CELL_M = 10.0

# Constants of step 3: where light begins to fall before the edge, and how round its corner is.
_SHOULDER = 0.3
_CORNER = 0.08

# The torus is turned against the drift by the slope of the golden ratio, which no fraction
# approximates well: a track that leaves one side comes back far from where it passed before.
_TRACK_SLOPE = (np.sqrt(5.0) - 1.0) / 2.0

# From one piece of sky to the next, in widths of the torus: powers of 1 / 1.3247, the plastic
# number, which spread the pieces evenly over it (M. Roberts, "The unreasonable effectiveness of
# quasirandom sequences", 2018).
_NEXT_PIECE = np.array([0.7548776662466927, 0.5698402909980532])


_BLOCK_POINTS: Final = 4
"""A block is averaged over this many points along each of its sides."""


class CloudSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The sky. The defaults are broken clouds in the trade wind of Oahu.

    cloud_cover: Share of the sky under clouds, averaged over hours.
    drift_speed_ms: Speed of the clouds [m/s].
    drift_from_deg: Where the clouds come from, clockwise from north [degree].
    cloud_size_m: Size of a typical cloud [m].
    cloud_softness: How gradually clouds darken inwards: 0.6 cumulus, 1.2 torn clouds.
    thick_cloud_index: Clear-sky index under the thickest cloud.
    edge_enhancement: Highest clear-sky index, between clouds; 1: no enhancement.
    evolution_s: Time in which groups of clouds change entirely [s].
    linke_turbidity: Linke turbidity of the clear sky.
    """

    cloud_cover: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.45
    drift_speed_ms: Annotated[float, Meta(ge=0.0, le=60.0)] = 10.0
    drift_from_deg: Annotated[float, Meta(ge=0.0, le=360.0)] = 65.0
    cloud_size_m: Annotated[float, Meta(ge=50.0, le=20_000.0)] = 800.0
    cloud_softness: Annotated[float, Meta(ge=0.1, le=5.0)] = 1.0
    thick_cloud_index: Annotated[float, Meta(ge=0.05, le=1.0)] = 0.4
    edge_enhancement: Annotated[float, Meta(ge=1.0, le=1.4)] = 1.2
    evolution_s: Annotated[float, Meta(ge=60.0, le=86_400.0)] = 2100.0
    linke_turbidity: Annotated[float, Meta(ge=1.0, le=10.0)] = 3.0


def clear_sky_ghi(
    times: pd.DatetimeIndex,
    lat_deg: Floats,
    lon_deg: Floats,
    altitude_m: float,
    linke_turbidity: float,
) -> Floats:
    """Return the clear-sky GHI at the centroid of the plant [W/m^2], shape (T,), 0 at night.

    The model is that of Ineichen and Perez (doi:10.1016/S0038-092X(02)00045-2).
    """
    place = float(lat_deg.mean()), float(lon_deg.mean()), altitude_m
    return _clear_sky_ghi(times.as_unit("ns").asi8.tobytes(), *place, linke_turbidity)


@lru_cache(maxsize=2)  # For the run and for its past.
def _clear_sky_ghi(
    times_ns: bytes, lat_deg: float, lon_deg: float, altitude_m: float, linke_turbidity: float
) -> Floats:
    times = pd.DatetimeIndex(np.frombuffer(times_ns, np.int64), tz="UTC")
    site = pvlib.location.Location(lat_deg, lon_deg, altitude=altitude_m)
    sky = site.get_clearsky(times, model="ineichen", linke_turbidity=linke_turbidity)
    return np.asarray(sky["ghi"].to_numpy(), dtype=np.float64)


def synthetic_ghi(
    times: pd.DatetimeIndex,
    lat_deg: Floats,
    lon_deg: Floats,
    altitude_m: float,
    settings: CloudSettings,
    seed: int,
    block_m: float = 0.0,
) -> Floats:
    """Draw the GHI at each sensor under drifting synthetic clouds [W/m^2], shape (T, N).

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
    settings, seed
        The sky, and the seed of the cloud field, at least 0.
    block_m
        Side of the square around each sensor over which the irradiance is a mean [m].
    """
    clear_wm2 = clear_sky_ghi(times, lat_deg, lon_deg, altitude_m, settings.linke_turbidity)
    time_s = (times - pd.Timestamp(0, tz="UTC")).total_seconds().to_numpy()
    east_m, north_m = east_north_m(lat_deg, lon_deg)
    offsets_m = [0.0]
    if block_m > 0.0:
        offsets_m = [block_m * ((row + 0.5) / _BLOCK_POINTS - 0.5) for row in range(_BLOCK_POINTS)]
    index = np.zeros((len(times), len(lat_deg)))
    for north_by_m, east_by_m in product(offsets_m, repeat=2):
        place = east_m + east_by_m, north_m + north_by_m
        index += clear_sky_index(time_s, *place, settings, seed)
    return clear_wm2[:, None] * (index / len(offsets_m) ** 2)


def clear_sky_index(
    time_s: Floats, east_m: Floats, north_m: Floats, settings: CloudSettings, seed: int
) -> Floats:
    """Draw the clear-sky index at each place under drifting synthetic clouds, shape (T, N).

    Times, shape (T,), are seconds since any epoch, in any order; places, shape (N,), are metres
    from any origin.
    """
    x_m, y_m = _in_the_drifting_field(time_s, east_m, north_m, settings)
    layers = _layers(settings.cloud_size_m, settings.evolution_s, seed)
    coarse, fine = (_blended(layer, time_s, x_m, y_m) for layer in layers)
    quantile = scipy.special.ndtri(1.0 - settings.cloud_cover)
    # Beside the coarse layer there is only the fine one, which is Gaussian.
    cover_around = scipy.special.ndtr((coarse - quantile) / layers[1].deviation)
    # Step 3 of the model: from the excess over the threshold to the clear-sky index.
    thick = settings.thick_cloud_index
    depth = (coarse + fine - quantile) / settings.cloud_softness + _SHOULDER
    transmitted = np.exp(-_CORNER * np.logaddexp(0.0, depth / _CORNER))
    scattered = (settings.edge_enhancement - 1.0) * 4.0 * cover_around * (1.0 - cover_around)
    return np.asarray(thick + (1.0 - thick + scattered) * transmitted)


@dataclass(frozen=True, slots=True, eq=False)
class _Layer:
    """A periodic random field of mean 0 and variance 1, and what it stands for.

    `in_common` is its correlation with itself from one piece of sky to the next.
    """

    field: NDArray[np.float32]
    in_common: float
    cell_m: float
    deviation: float
    lifetime_s: float


@lru_cache(maxsize=2)  # A run's own day may also be the history of its neighbours.
def _layers(cloud_size_m: float, evolution_s: float, seed: int) -> tuple[_Layer, _Layer]:
    """Draw steps 1 and 2 of the model: a coarse and a fine layer, whose variances add up to 1."""
    rng = np.random.default_rng(seed)
    outer_m = _OUTER_SCALE * cloud_size_m
    coarse_cell_m = max(_LEAST_COARSE_CELL_M, outer_m * _OUTER_SCALES_ACROSS / _COARSE_CELLS)
    around_m = max(_NEIGHBOURHOOD_M, 2.0 * coarse_cell_m)
    fine_cell_m = max(_LEAST_CELL_M, around_m * _NEIGHBOURHOODS_ACROSS / _FINE_CELLS)
    fine_lifetime_s = evolution_s * min(1.0, 0.5 * around_m / outer_m) ** (2.0 / 3.0)

    # Share of the fine layer in the variance: an integral over the plane of wave numbers.
    k = np.geomspace(1e-4 / outer_m, 6.0 / _SMOOTHING_M, 10_000)
    power = _power(k**2, outer_m) * k
    fine_part = -np.expm1(-((k * around_m) ** 2))
    fine_share = float(np.trapezoid(power * fine_part, k) / np.trapezoid(power, k))
    k_squared = _wave_numbers_squared(_COARSE_CELLS, coarse_cell_m)
    coarse = _random_field(rng, _power(k_squared, outer_m) * np.exp(-k_squared * around_m**2))
    k_squared = _wave_numbers_squared(_FINE_CELLS, fine_cell_m)
    fine = _random_field(rng, -_power(k_squared, outer_m) * np.expm1(-k_squared * around_m**2))
    return (
        _Layer(*coarse, coarse_cell_m, np.sqrt(1.0 - fine_share), evolution_s),
        _Layer(*fine, fine_cell_m, np.sqrt(fine_share), fine_lifetime_s),
    )


def _power(k_squared: Floats, outer_m: float) -> Floats:
    power = (1.0 + k_squared * outer_m**2) ** _SPECTRUM_EXPONENT
    return np.asarray(power * np.exp(-k_squared * _SMOOTHING_M**2))


def _wave_numbers_squared(cells: int, cell_m: float) -> Floats:
    k_y = 2.0 * np.pi * scipy.fft.fftfreq(cells, cell_m)[:, None]
    k_x = 2.0 * np.pi * scipy.fft.rfftfreq(cells, cell_m)[None, :]
    return np.asarray(k_x**2 + k_y**2)


def _random_field(rng: np.random.Generator, power: Floats) -> tuple[NDArray[np.float32], float]:
    """Draw a periodic Gaussian field of mean 0, variance 1 and a power spectrum.

    It comes with what two pieces of sky have in common.
    """
    cells = len(power)
    amplitude = np.sqrt(power).astype(np.float32)
    noise = rng.standard_normal((cells, cells), dtype=np.float32)
    field = scipy.fft.irfft2(scipy.fft.rfft2(noise) * amplitude, s=noise.shape)
    field = np.asarray((field - field.mean()) / field.std(), dtype=np.float32)
    shift = np.rint(_NEXT_PIECE * cells).astype(int)
    return field, float(np.mean(field * np.roll(field, -shift, axis=(0, 1))))


def _blended(layer: _Layer, time_s: Floats, x_m: Floats, y_m: Floats) -> Floats:
    """Step 2 of the model: what a layer contributes at each time and sensor, shape (T, N)."""
    age = time_s / layer.lifetime_s
    piece = np.floor(age)
    phase = 0.5 * np.pi * (age - piece)[:, None]
    first = _read(layer, x_m, y_m, piece)
    second = _read(layer, x_m, y_m, piece + 1.0)
    # Without the root, what two pieces have in common by chance would make the variance pulsate.
    variance = 1.0 + layer.in_common * np.sin(2.0 * phase)
    mixed = first * np.cos(phase) + second * np.sin(phase)
    return np.asarray(layer.deviation * mixed / np.sqrt(variance))


def _read(layer: _Layer, x_m: Floats, y_m: Floats, piece: Floats) -> NDArray[np.float32]:
    cells = len(layer.field)
    offset = (piece[:, None] * _NEXT_PIECE % 1.0) * cells
    # Modulo here, since single cells are lost in the rounding of coordinates of 1e9 cells.
    rows = _wrapped(y_m / layer.cell_m + offset[:, :1], cells)
    columns = _wrapped(x_m / layer.cell_m + offset[:, 1:], cells)
    return np.asarray(
        scipy.ndimage.map_coordinates(layer.field, [rows, columns], order=1, mode="grid-wrap")
    )


def _wrapped(at: Floats, cells: int) -> Floats:
    """Return `at % cells` of a power of two, to the last bit, in half the time."""
    return np.asarray(at - np.floor(at / cells) * cells)


def _in_the_drifting_field(
    time_s: Floats, east_m: Floats, north_m: Floats, settings: CloudSettings
) -> tuple[Floats, Floats]:
    """Where each sensor is at each time in the field that drifts [m], shape (T, N) each."""
    origin = np.deg2rad(settings.drift_from_deg)
    towards_east, towards_north = -np.sin(origin), -np.cos(origin)
    along = (east_m * towards_east + north_m * towards_north)[None, :]
    along = along - settings.drift_speed_ms * time_s[:, None]
    across = _STRETCH * (north_m * towards_east - east_m * towards_north)
    across = np.broadcast_to(across, along.shape)
    turn = np.arctan(_TRACK_SLOPE)
    x_m = along * np.cos(turn) - across * np.sin(turn)
    return x_m, along * np.sin(turn) + across * np.cos(turn)
