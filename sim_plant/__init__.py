"""The world: irradiance, PV power, inverters, what the market wants, and the plant as an agent."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
