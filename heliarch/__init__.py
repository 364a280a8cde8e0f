"""Heliarch for Python: what scripts and notebooks need.

Examples
--------
>>> from heliarch import compare, compare_runs, open_run, simulate
>>> run = simulate("oahu", duration="10m", out="runs/first")
>>> print(run.summary.figures)
>>> with open_run(run.folder) as recording:
...     print(recording.plan.inverters)
>>> table = compare("oahu", schemes=["paper", "uniform-cap"], seeds=range(1, 6))
>>> print(compare_runs("runs/first", "runs/second").differences)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from heliarch.runs import ComparedRuns, SimulatedRun, compare, compare_runs, simulate
    from recordings import open_run
    from scenarios.scenario import load_scenario

__all__ = [
    "ComparedRuns",
    "SimulatedRun",
    "compare",
    "compare_runs",
    "load_scenario",
    "open_run",
    "simulate",
]

_ELSEWHERE = {"load_scenario": "scenarios.scenario", "open_run": "recordings"}
"""Modules of what is not in `heliarch.runs`."""


def __getattr__(name: str) -> object:
    """Import what is asked for when it is first used: `import heliarch` alone is quick."""
    if name not in __all__:
        raise AttributeError(f"module 'heliarch' has no attribute {name!r}")
    found: object = getattr(import_module(_ELSEWHERE.get(name, "heliarch.runs")), name)
    return found


def __dir__() -> list[str]:
    return __all__
