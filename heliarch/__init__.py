"""Heliarch for Python: what scripts and notebooks need.

Here belong the public names and the commands (`cli`); it may import every folder, and none imports
it. Begin with `runs.py`, for a command with its file in `cli`.

Examples
--------
>>> from heliarch import compare, diff, launch, open_run, simulate
>>> run = simulate("oahu", duration="10m", out="runs/first")
>>> run.metrics["control-caused"], run.power.sum(axis=1), run.frame("help_given")
>>> with open_run("runs/first") as recording:
...     tables = recording.frames("impp", "setpoint", nodes="c2/*", start="12:01", end="12:02")
>>> table = compare("oahu", schemes=["paper", "uniform-cap"], seeds=range(1, 6))
>>> print(diff("runs/first", "runs/second").differences)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bus_schemas.errors import InputError
    from heliarch.recorded import Run, open_run, with_units
    from heliarch.runs import (
        Diff,
        compare,
        diff,
        export,
        launch,
        simulate,
        timing,
        verify,
    )
    from scenarios.scenario import load_scenario

__all__ = [
    "Diff",
    "InputError",
    "Run",
    "compare",
    "diff",
    "export",
    "launch",
    "load_scenario",
    "open_run",
    "simulate",
    "timing",
    "verify",
    "with_units",
]

_ELSEWHERE = {
    "InputError": "bus_schemas.errors",
    "Run": "heliarch.recorded",
    "load_scenario": "scenarios.scenario",
    "open_run": "heliarch.recorded",
    "with_units": "heliarch.recorded",
}
"""Modules of what is not in `heliarch.runs`."""


def __getattr__(name: str) -> object:
    """Import what is asked for when it is first used: `import heliarch` alone is quick."""
    if name not in __all__:
        raise AttributeError(f"module 'heliarch' has no attribute {name!r}")
    found: object = getattr(import_module(_ELSEWHERE.get(name, "heliarch.runs")), name)
    return found


def __dir__() -> list[str]:
    return __all__
