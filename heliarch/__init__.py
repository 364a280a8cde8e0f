"""Heliarch for Python: what scripts and notebooks need.

Examples
--------
>>> from heliarch import compare, open_run, simulate
>>> run = simulate("oahu", duration="10m", out="runs/first")
>>> print(run.summary.metrics)
>>> with open_run(run.folder) as recording:
...     print(recording.plan.inverters)
>>> table = compare("oahu", schemes=["paper", "uniform-cap"], seeds=range(1, 6))
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from heliarch.runs import SimulatedRun, compare, simulate
    from launch_scripts.scenarios.scenario import load_scenario
    from recordings import open_run

__all__ = ["SimulatedRun", "compare", "load_scenario", "open_run", "simulate"]

_MODULES = {
    "SimulatedRun": "heliarch.runs",
    "compare": "heliarch.runs",
    "load_scenario": "launch_scripts.scenarios.scenario",
    "open_run": "recordings",
    "simulate": "heliarch.runs",
}


def __getattr__(name: str) -> object:
    """Import what is asked for when it is first used: `import heliarch` alone is quick."""
    if name not in _MODULES:
        raise AttributeError(f"module 'heliarch' has no attribute {name!r}")
    found: object = getattr(import_module(_MODULES[name]), name)
    return found


def __dir__() -> list[str]:
    return __all__
