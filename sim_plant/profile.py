"""The profile of a run: what sun and market do, cycle by cycle, worked out before it begins."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Final

import numpy as np

from bus_schemas.errors import InputError
from sim_plant import Floats

PROFILE_NAME: Final = "profile.npz"
"""Its file in the folder of a run."""

_HEADER_BYTES: Final = 4_096


@dataclass(frozen=True, slots=True)
class Profile:
    """True maximum power of each inverter, and what the operator wants, for each cycle of a run.

    `mpp_kw` [cycles, inverters] is clipped at the rating. The operator wants the commitment, and
    regulation of either sign on top of it [cycles]; the capacity is what a regulation signal of +1
    stands for. Row k of `meter_error` [cycles, inverters] is the relative error of the power in the
    telemetry sent in cycle k. `clear_sky_kw` is the plant's power under a clear sky [cycles], if
    the commitment is offered as a share of that. `frequency_hz` is the grid's at the beginning of
    each cycle [cycles]. By default there is no regulation, the meters are exact, the commitment is
    given, and no meter measures the frequency.
    """

    mpp_kw: Floats
    commitment_kw: Floats
    regulation_kw: Floats = field(default_factory=lambda: np.zeros(0))
    regulation_capacity_kw: float = 0.0
    meter_error: Floats = field(default_factory=lambda: np.zeros(0))
    clear_sky_kw: Floats = field(default_factory=lambda: np.zeros(0))
    frequency_hz: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not self.regulation_kw.size:
            object.__setattr__(self, "regulation_kw", np.zeros_like(self.commitment_kw))
        if not self.meter_error.size:
            object.__setattr__(self, "meter_error", np.zeros_like(self.mpp_kw))

    @property
    def cycles(self) -> int:
        return len(self.mpp_kw)

    def frequency_at(self, cycle: int) -> float | None:
        return float(self.frequency_hz[cycle]) if self.frequency_hz.size else None

    def save(self, path: Path) -> None:
        np.savez_compressed(path, **{one.name: getattr(self, one.name) for one in fields(self)})


def load_profile(path: Path, cycles: int, inverters: int) -> Profile:
    """Read the profile of a run of so many cycles; a larger one is not unpacked."""
    most_bytes = 8 * (cycles + 1) * inverters + _HEADER_BYTES
    try:
        with np.load(path) as archive:
            if any(one.file_size > most_bytes for one in archive.zip.infolist()):
                raise InputError(
                    f"{path}: expected a profile of {cycles:,} cycles, got a larger one"
                )
            names = [one.name for one in fields(Profile) if one.name in archive]
            found = {name: archive[name] for name in names}
        capacity_kw = float(found.pop("regulation_capacity_kw"))
        return Profile(**found, regulation_capacity_kw=capacity_kw)
    except InputError:
        raise
    except Exception as error:  # A damaged archive can fail in numpy, zip or anywhere below.
        got = type(error).__name__
        raise InputError(f"{path}: expected the profile.npz of a run, got: {got}") from None
