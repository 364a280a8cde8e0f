"""Daily files of the Oahu grid, made by hand in their format."""

from __future__ import annotations

from datetime import date

import numpy as np
import pandas as pd
from numpy.typing import NDArray


def day_text(day: date, ghi_wm2: NDArray[np.float64], begin: str = "12:00") -> str:
    """A file of the archive: a second to a line, -99999 where a value is missing."""
    times = pd.date_range(f"{day} {begin}", periods=len(ghi_wm2), freq="1s")
    lines = [
        f"{time.second},{time.year},{time.day_of_year},{100 * time.hour + time.minute},"
        + ",".join("-99999" if np.isnan(v) else f"{v:.4f}" for v in row)
        for time, row in zip(times, ghi_wm2.tolist(), strict=True)
    ]
    return "\n".join(lines) + "\n"
