"""Statistics of many cases: means with their intervals, quantiles, paired differences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from agents.plan import Actuator
from studies.compare.study import CaseResult
from studies.metrics.figures_of_merit import FIGURES_OF_MERIT, FigureOfMerit

QUANTILES: Final = {"5 %": 0.05, "median": 0.5, "95 %": 0.95}
_UPPER: Final = 0.975
"""Of an interval that holds the true mean with 95 %, both tails alike."""


class Summary(NamedTuple):
    """One figure of merit of one scheme over cases with the same settings.

    Errors are half the width of a 95 % interval by Student's t, None for one case; `low` and `high`
    the quantiles at 5 and 95 %. `difference` is the mean of this scheme less the baseline, case by
    case.
    """

    figure: str
    unit: str
    settings: str
    scheme: str
    actuator: Actuator | None
    cases: int
    mean: float | None
    mean_error: float | None
    low: float
    median: float
    high: float
    baseline: str
    difference: float | None
    difference_error: float | None


def summaries(
    results: Sequence[CaseResult],
    figures: Iterable[FigureOfMerit] = tuple(FIGURES_OF_MERIT.values()),
) -> list[Summary]:
    """Summarise each figure of each scheme, for each choice of settings.

    Where the cases differ in nothing but settings, these are taken together. The baseline is
    `predictive`, else the first scheme, with the same actuator.
    """
    samples: dict[str, list[CaseResult]] = {}
    for result in results:
        samples.setdefault(result.settings, []).append(result)
    if len(samples) == len(results):
        samples = {"": list(results)}
    entries = results[0].schemes
    names = [entry.scheme for entry in entries]
    baseline = "predictive" if "predictive" in names else names[0]
    baselines = {
        entry.actuator: place for place, entry in enumerate(entries) if entry.scheme == baseline
    }
    found = []
    for figure in figures:
        for settings, cases in samples.items():
            values = values_of(figure, cases)
            actuators = actuators_of(cases)
            for place, entry in enumerate(entries):
                beside = baselines.get(entry.actuator, names.index(baseline))
                own = _known(values[:, place])
                less = _known(values[:, place] - values[:, beside])
                if not len(own):
                    continue
                low, median, high = np.quantile(own, list(QUANTILES.values())).tolist()
                found.append(
                    Summary(
                        figure.name,
                        figure.unit,
                        settings,
                        entry.scheme,
                        actuators[place],
                        len(own),
                        *_mean_and_error(own),
                        low,
                        median,
                        high,
                        baseline,
                        *(_mean_and_error(less) if beside != place else (None, None)),
                    )
                )
    return found


def values_of(figure: FigureOfMerit, cases: Sequence[CaseResult]) -> NDArray[np.float64]:
    """Return a figure in each case under each scheme, shape (cases, schemes); NaN: not defined."""
    rows = [[figure.read(entry.metrics) for entry in case.schemes] for case in cases]
    return np.array(rows, dtype=float)


def actuators_of(cases: Sequence[CaseResult]) -> list[Actuator | None]:
    """Return the actuator of each scheme; None for a bound, and where cases differ in it."""
    of_schemes = zip(*([entry.actuator for entry in case.schemes] for case in cases), strict=True)
    return [found[0] if len(set(found)) == 1 else None for found in of_schemes]


def _known(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return values[~np.isnan(values)]


def _mean_and_error(values: NDArray[np.float64]) -> tuple[float | None, float | None]:
    count = len(values)
    mean = float(values.mean()) if count else None
    if count < 2:
        return mean, None
    return mean, float(stdtrit(count - 1, _UPPER) * values.std(ddof=1) / sqrt(count))
