"""The profile of a run: what sun and market do, cycle by cycle, worked out before it begins."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bus_schemas.errors import InputError


@dataclass(frozen=True, slots=True)
class Profile:
    """True maximum power of each inverter, and the commitment, for each cycle of a run.

    Attributes
    ----------
    mpp_kw
        AC power that the irradiance would allow, clipped at the rating, shape (cycles, inverters).
    commitment_kw
        Power promised for each cycle, shape (cycles,).
    """

    mpp_kw: NDArray[np.float64]
    commitment_kw: NDArray[np.float64]

    @property
    def cycles(self) -> int:
        """Number of cycles."""
        return len(self.mpp_kw)

    def save(self, path: Path) -> None:
        """Write the profile as a compressed numpy archive."""
        np.savez_compressed(path, mpp_kw=self.mpp_kw, commitment_kw=self.commitment_kw)


def load_profile(path: Path) -> Profile:
    """Read a profile.

    Raises
    ------
    InputError
        There is no such file.
    """
    try:
        with np.load(path) as archive:
            return Profile(archive["mpp_kw"], archive["commitment_kw"])
    except FileNotFoundError:
        raise InputError(f"{path}: no such file, accepted is the profile.npz of a run") from None
    except Exception as error:  # A damaged archive can fail in numpy, zip or anywhere below.
        reason = type(error).__name__
        raise InputError(
            f"{path}: not readable ({reason}), accepted is the profile.npz of a run"
        ) from None
