"""How far from its due time each message went out, as a distribution of bounded size."""

from __future__ import annotations

from collections import Counter
from typing import Final

_FINE_BITS: Final = 7
"""A bucket is narrower than 2**-7 of its value: figures are exact to 0.8 %."""


class TimingError:
    """Times between when messages were due and when they had been handed to the bus.

    Attributes
    ----------
    count
        Number of messages.
    max_ns
        The largest error [ns].
    """

    def __init__(self) -> None:
        self.count = 0
        self.max_ns = 0
        self._buckets: Counter[int] = Counter()

    def add(self, error_ns: int) -> None:
        """Count one message.

        Parameters
        ----------
        error_ns
            Sent less due [ns], not below 0: nothing is sent early.
        """
        self.count += 1
        self.max_ns = max(self.max_ns, error_ns)
        coarse = max(error_ns.bit_length() - _FINE_BITS - 1, 0)
        self._buckets[(coarse << (_FINE_BITS + 1)) + (error_ns >> coarse)] += 1

    def percentile_ns(self, percent: float) -> int:
        """Return the error that so many percent of the messages do not exceed [ns].

        Parameters
        ----------
        percent
            Above 0, up to 100.

        Raises
        ------
        ValueError
            There is no message.
        """
        if not self.count:
            raise ValueError("no message was timed")
        wanted = self.count * percent / 100.0
        seen = 0
        for bucket in sorted(self._buckets):
            seen += self._buckets[bucket]
            if seen >= wanted:
                coarse, fine = divmod(bucket, 1 << (_FINE_BITS + 1))
                return min(((fine + 1) << coarse) - 1, self.max_ns)
        return self.max_ns
