"""A synthetic regulation signal that moves like PJM's RegD, for where the real one is not at hand.

The signal comes from a formula, a seed and the local time alone, so a part of a day is the same
whatever run it is seen in. It repeats after 40 days, which is longer than a run can be.

1. A Gaussian process x of zero mean and unit variance is drawn with the power spectrum ::

       S(f) = (f T_n)^2 / (1 + (f T_n)^2)        energy-neutral: nothing at f = 0
              (1 + (f T_c)^2)^-0.93              a plateau, then close to f^-2
              (1 / (1 + (f T_k)^8) + 0.005)      smooth within a minute, a little rough within that

   with T_n = 6000 s, T_c = 2000 s, T_k = 85 s.
2. It is read on a clock that runs fast and slow: ``y(t) = 0.69 x(tau(t))``, d tau / dt = v, where
   v is log-normal (mean 1, standard deviation of its logarithm 0.45) with a memory of half a
   minute. That leaves the distribution of x as it is and gives its steps the heavy tails that
   the real signal's steps have.
3. The signal is y clipped to [-1, 1], one value every 2 s. A Gaussian process with the standard
   deviation 0.69 is beyond +-1 for 14.7 % of the time: that is how long RegD stands at its ends.

The method is this project's own. Its constants were set beside two whole days of the real signal;
`docs/metrics.md` has real and synthetic statistics side by side.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import fft

STEP_S: Final = 2
"""PJM sends a value of RegD every 2 s."""

SAMPLES: Final = 40 * 86_400 // STEP_S
"""Samples after which the signal repeats: 40 days, a number that is quick to transform."""

_NEUTRAL_S: Final = 6000.0
_PLATEAU_S: Final = 2000.0
_SLOPE: Final = 0.93
_SMOOTH_S: Final = 85.0
_SMOOTH_ORDER: Final = 8
_ROUGHNESS: Final = 0.005
_LATENT_STD: Final = 0.69
_PACE_LOG_STD: Final = 0.45
_PACE_MEMORY_S: Final = 30.0


def synthetic_regd(seed: int) -> NDArray[np.float64]:
    """Draw the 40 days of a seed.

    Parameters
    ----------
    seed : int
        At least 0.

    Returns
    -------
    numpy.ndarray, shape (SAMPLES,)
        Regulation signal in per unit, -1 to +1, one value every 2 s, positive: raise output. The
        end joins the beginning without a jump.
    """
    rng = np.random.default_rng(seed)
    frequency_hz = fft.rfftfreq(SAMPLES, STEP_S)
    latent = _LATENT_STD * _gaussian(rng, _signal_spectrum(frequency_hz))
    pace = np.exp(_PACE_LOG_STD * _gaussian(rng, _pace_spectrum(frequency_hz)))
    clock = np.cumsum(pace) * (SAMPLES / pace.sum())
    # The clock has gone round once when the 40 days are over: one value more closes the circle.
    closed = np.append(latent, latent[0])
    return np.asarray(np.interp(clock, np.arange(SAMPLES + 1.0), closed).clip(-1.0, 1.0))


def _signal_spectrum(frequency_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    slow = (frequency_hz * _NEUTRAL_S) ** 2
    plateau = (1.0 + (frequency_hz * _PLATEAU_S) ** 2) ** -_SLOPE
    smooth = 1.0 / (1.0 + (frequency_hz * _SMOOTH_S) ** _SMOOTH_ORDER) + _ROUGHNESS
    return np.asarray(slow / (1.0 + slow) * plateau * smooth)


def _pace_spectrum(frequency_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray((1.0 + (frequency_hz * _PACE_MEMORY_S) ** 2) ** -2)


def _gaussian(rng: np.random.Generator, spectrum: NDArray[np.float64]) -> NDArray[np.float64]:
    """Draw a periodic Gaussian process of a power spectrum, of zero mean and unit variance."""
    draws = rng.standard_normal((2, len(spectrum)))
    process = fft.irfft((draws[0] + 1j * draws[1]) * np.sqrt(spectrum), n=SAMPLES)
    process -= process.mean()
    return np.asarray(process / process.std())
