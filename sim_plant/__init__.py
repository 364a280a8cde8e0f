"""The world: irradiance, PV power, inverters, what the market wants, and the plant as an agent.

Here belongs what a controller cannot know and what measured files say. It imports `agents` and
`bus_schemas`. Begin with `plant.py`, then `sources.py` and `inverters.py`.
"""

import sys
from importlib.util import LazyLoader, find_spec, module_from_spec
from types import ModuleType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]


def imported_when_used(name: str) -> ModuleType:
    """Return a module that is imported at its first use: half a second, in the case of pvlib."""
    if name in sys.modules:
        return sys.modules[name]
    spec = find_spec(name)
    if spec is None or spec.loader is None:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    spec.loader = LazyLoader(spec.loader)
    module = sys.modules[name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def whole_cycles(time_s: float, cycle_s: float) -> float:
    """Return how many cycles a time takes; a part of one is one, but no rounding error is."""
    return float(np.ceil(round(time_s / cycle_s, 9)))
