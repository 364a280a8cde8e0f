"""`heliarch diff`: two recorded runs side by side."""

from __future__ import annotations

from heliarch.cli.boundary import FAILED, OK
from heliarch.cli.options import Json, Report, ResultOptions, Run
from heliarch.cli.output import publish


def diff(first: Run, second: Run, /, *, report: Report = None, json: Json = None) -> int:
    """Compare two recorded runs: scenarios, figures, every message.

    Both runs must be of the same plant and begin at the same time. Exit status 1: they differ, or
    not all of both could be compared. --report writes diff.html by default.

    Example: `heliarch diff runs/before runs/after`

    Parameters
    ----------
    second
        The same, of the run to compare the first with.
    """
    from results.two_runs import diff_runs

    result = diff_runs((first, second))
    publish(result, ResultOptions(report=report, json=json), "diff.html")
    return OK if result.verdict is not None and result.verdict[0] else FAILED
