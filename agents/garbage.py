"""The cyclic garbage collector, kept out of the loop."""

from __future__ import annotations

import gc


def spare_the_collector(*, interludes: bool = False) -> None:
    """Keep the cyclic garbage collector off what lives as long as the process.

    Nothing in a cycle of control makes reference cycles: there is next to nothing to collect. Where
    there are interludes it has its turn in them, and is off otherwise.
    """
    gc.collect()
    gc.freeze()
    if interludes:
        gc.disable()
    else:
        gc.set_threshold(50_000)
