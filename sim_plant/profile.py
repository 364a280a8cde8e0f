"""The profile of a run: what sun and market do, cycle by cycle, worked out before it begins."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bus_schemas.errors import InputError


def _not_given() -> NDArray[np.float64]:
    return np.zeros(0)


@dataclass(frozen=True, slots=True)
class Profile:
    """True maximum power of each inverter, and what the operator wants, for each cycle of a run.

    Attributes
    ----------
    mpp_kw
        AC power that the irradiance would allow, clipped at the rating, shape (cycles, inverters).
    commitment_kw
        Power promised for each cycle, shape (cycles,).
    regulation_kw
        Power that the operator wants on top of it, of either sign, shape (cycles,). By default
        none.
    regulation_capacity_kw
        Power that a regulation signal of +1 stands for; 0 if there is no regulation.
    meter_error
        Relative error of the power that each inverter measures, shape (cycles, inverters). Row k
        is that of the telemetry sent in cycle k. By default the meters are exact.
    """

    mpp_kw: NDArray[np.float64]
    commitment_kw: NDArray[np.float64]
    regulation_kw: NDArray[np.float64] = field(default_factory=_not_given)
    regulation_capacity_kw: float = 0.0
    meter_error: NDArray[np.float64] = field(default_factory=_not_given)

    def __post_init__(self) -> None:
        if not self.regulation_kw.size:
            object.__setattr__(self, "regulation_kw", np.zeros_like(self.commitment_kw))
        if not self.meter_error.size:
            object.__setattr__(self, "meter_error", np.zeros_like(self.mpp_kw))

    @property
    def cycles(self) -> int:
        """Number of cycles."""
        return len(self.mpp_kw)

    def save(self, path: Path) -> None:
        """Write the profile as a compressed numpy archive."""
        np.savez_compressed(
            path, **{entry.name: getattr(self, entry.name) for entry in fields(self)}
        )


def load_profile(path: Path) -> Profile:
    """Read a profile.

    Raises
    ------
    InputError
        There is no such file.
    """
    try:
        with np.load(path) as archive:
            return Profile(
                archive["mpp_kw"],
                archive["commitment_kw"],
                archive["regulation_kw"],
                float(archive["regulation_capacity_kw"]),
                archive["meter_error"],
            )
    except FileNotFoundError:
        raise InputError(f"{path}: expected the profile.npz of a run, got no such file") from None
    except Exception as error:  # A damaged archive can fail in numpy, zip or anywhere below.
        reason = type(error).__name__
        raise InputError(
            f"{path}: expected the profile.npz of a run, got one that is not readable ({reason})"
        ) from None
