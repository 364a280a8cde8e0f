"""HDR histograms of durations, as the processes of a run keep them."""

from __future__ import annotations

from typing import Final, NamedTuple

from hdrh.histogram import HdrHistogram

LOWEST_NS: Final = 1_000
HIGHEST_NS: Final = 3_600_000_000_000
SIGNIFICANT_FIGURES: Final = 2
"""What a histogram tells apart: 1 us to 1 h, to 1 %."""


def new_histogram() -> HdrHistogram:
    """Return an empty histogram of nanoseconds."""
    return HdrHistogram(LOWEST_NS, HIGHEST_NS, SIGNIFICANT_FIGURES)


def record_ns(histogram: HdrHistogram, duration_ns: int) -> None:
    """Take in a duration; one below 0 counts as 0, and one above an hour as an hour."""
    histogram.record_value(min(max(duration_ns, 0), HIGHEST_NS))


class Extremes(NamedTuple):
    """Least and greatest of some durations, of which a histogram tells its bins alone [ns]."""

    least_ns: int
    greatest_ns: int

    def with_others(self, others: Extremes) -> Extremes:
        """Return those of both."""
        return Extremes(
            min(self.least_ns, others.least_ns), max(self.greatest_ns, others.greatest_ns)
        )


def extremes_of(histogram: HdrHistogram) -> Extremes:
    """Return the exact extremes of what a histogram has recorded; to be asked before it is encoded.

    Of one that was decoded they are the outer edges of its outermost bins.
    """
    return Extremes(histogram.min_value, histogram.max_value)


class Histograms:
    """Histograms of durations by measure, made as they are needed."""

    def __init__(self) -> None:
        self._by_measure: dict[str, HdrHistogram] = {}

    def extremes(self) -> dict[str, Extremes]:
        """Return the least and the greatest duration of each measure."""
        items = sorted(self._by_measure.items())
        return {measure: extremes_of(histogram) for measure, histogram in items}

    def record(self, measure: str, duration_ns: int) -> None:
        """Take in a duration, see `record_ns`."""
        histogram = self._by_measure.get(measure)
        if histogram is None:
            histogram = self._by_measure[measure] = new_histogram()
        record_ns(histogram, duration_ns)

    def encoded(self) -> dict[str, str]:
        """Return them as text, by measure in the order of the alphabet."""
        items = sorted(self._by_measure.items())
        return {measure: histogram.encode().decode("ascii") for measure, histogram in items}
