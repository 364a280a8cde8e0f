"""A synthetic regulation signal that moves like PJM's RegD, for where the real one is not at hand.

The signal comes from a formula, a seed and the local time alone, so a part of a day is the same
whatever run it is seen in. It repeats after 40 days, which is longer than a run can be.

1. A Gaussian process x of zero mean and unit variance is drawn with the power spectrum
   ``(f T_n)^2 / (1 + (f T_n)^2) (1 + (f T_c)^2)^-0.91``: energy-neutral, so nothing at f = 0; then
   a plateau; then close to f^-2. T_n = 5000 s, T_c = 1700 s.
2. It is read on a clock that runs fast and slow: ``x(tau(t))``, d tau / dt = v, where v is
   log-normal (standard deviation of its logarithm 1.46) with a memory of 40 s. That gives its steps
   the heavy tails that the real signal's steps have.
3. A low-pass filter with the power response ``1 / (1 + (f T_k)^10)``, T_k = 77 s, makes it smooth
   within a minute; a small share of x(tau(t)) is added to what it returns, for roughness.
4. The signal is that times 0.66, plus an offset, clipped to [-1, 1], one value every 2 s. It is at
   its ends for 15 % of the time, as RegD is.
5. Days differ in offset, and in the logarithms of amplitude, pace (the mean of v) and roughness.
   Each is normally distributed over the days, in force at noon and linear in between.

The method is this project's own. Its constants were set beside two whole days of the real signal.
`docs/metrics.md` has the statistics of both, and the reason for how much the days differ.
"""

from typing import Final

import numpy as np
import scipy

from sim_plant import Floats

STEP_S: Final = 2
"""PJM sends a value of RegD every 2 s."""

_DAYS: Final = 40
SAMPLES: Final = _DAYS * 86_400 // STEP_S
"""Samples after which the signal repeats: 40 days, a number that is quick to transform."""

_NEUTRAL_S: Final = 5000.0
_PLATEAU_S: Final = 1700.0
_SLOPE: Final = 0.91
_PACE_LOG_STD: Final = 1.46
_PACE_MEMORY_S: Final = 40.0
_SMOOTH_S: Final = 77.0
_SMOOTH_ORDER: Final = 10
_ROUGHNESS: Final = 0.073
_STD: Final = 0.66
_DAY_STDS: Final = (0.05, 0.22, 0.25, 0.3)
"""How much days differ in offset, and in the logarithms of amplitude, pace and roughness."""


def synthetic_regd(seed: int) -> Floats:
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
    frequency_hz = scipy.fft.rfftfreq(SAMPLES, STEP_S)
    neutral = (frequency_hz * _NEUTRAL_S) ** 2
    plateau = (1.0 + (frequency_hz * _PLATEAU_S) ** 2) ** -_SLOPE
    latent = _gaussian(rng, neutral / (1.0 + neutral) * plateau)
    lasting = (1.0 + (frequency_hz * _PACE_MEMORY_S) ** 2) ** -2
    quickness = _PACE_LOG_STD * _gaussian(rng, lasting)
    offset, amplitude, pace, roughness = _of_the_day(rng)
    speed = np.exp(quickness + pace)
    clock = np.cumsum(speed) * (SAMPLES / speed.sum())
    # The clock has gone round once when the 40 days are over: one value more closes the circle.
    closed = np.append(latent, latent[0])
    rough = np.interp(clock, np.arange(SAMPLES + 1.0), closed)
    kept = (1.0 + (frequency_hz * _SMOOTH_S) ** _SMOOTH_ORDER) ** -0.5
    smooth = scipy.fft.irfft(scipy.fft.rfft(rough) * kept, n=SAMPLES)
    moving = _STD * np.exp(amplitude) * (smooth + _ROUGHNESS * np.exp(roughness) * rough)
    return np.asarray((offset + moving).clip(-1.0, 1.0))


def _of_the_day(rng: np.random.Generator) -> list[Floats]:
    """Draw the four effects that vary from day to day."""
    noon = np.arange(_DAYS) + 0.5
    day = np.arange(SAMPLES) * (_DAYS / SAMPLES)
    # Normal quantiles in random order: each seed has the same variety of days.
    normal = scipy.special.ndtri(noon / _DAYS)
    return [std * np.interp(day, noon, rng.permutation(normal), period=_DAYS) for std in _DAY_STDS]


def _gaussian(rng: np.random.Generator, spectrum: Floats) -> Floats:
    """Draw a periodic Gaussian process of a power spectrum, of zero mean and unit variance."""
    draws = rng.standard_normal((2, len(spectrum)))
    process = scipy.fft.irfft((draws[0] + 1j * draws[1]) * np.sqrt(spectrum), n=SAMPLES)
    process -= process.mean()
    return np.asarray(process / process.std())
