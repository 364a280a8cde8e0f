"""What the meters of a run read: that of all, and those of the plants of a fleet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from agents.control.allocation import total
from agents.control.grid import net_kw
from agents.plan import RunPlan
from bus_schemas.tree import PLANT, ROOT
from sim_plant import Floats

_NONE: Final = np.zeros(0)


class Meters:
    """The meters of a plan. Powers are of its inverters, or of the clusters that stand for them.

    A fleet has no meter but those of its plants: what it feeds in is the sum of them.
    """

    def __init__(self, plan: RunPlan, columns: Sequence[str] = ()) -> None:
        tree, self._laws = plan.tree, plan.grid_laws
        self._errors = {one.name: one.grid.meter_error_percent / 100.0 for one in plan.plants}
        self._errors[ROOT] = plan.grid.meter_error_percent / 100.0
        self._columns = {name: _below(name, columns or tree.leaves) for name in tree.meters}
        self._storages = {name: _below(name, tree.storage_paths) for name in tree.meters}
        # One column may stand for all, at the fleet's meter.
        self.plants = tree.meters[1:] if list(columns) != [PLANT] else ()
        self._beside = [
            at
            for at, path in enumerate(tree.storage_paths)
            if path.split("/")[0] not in self.plants
        ]

    def readings_kw(self, power_kw: Sequence[float], stored_kw: Sequence[float]) -> list[float]:
        """Return what each meter reads, that of all first."""
        found = [
            net_kw(
                total([power_kw[at] for at in self._columns[name]])
                + total([stored_kw[at] for at in self._storages[name]]),
                self._laws[name],
            )
            * (1.0 + self._errors[name])
            for name in self.plants
        ]
        gross_kw = total(found) if found else total(power_kw)
        beside_kw = total([stored_kw[at] for at in self._beside])
        whole_kw = net_kw(gross_kw + beside_kw, self._laws[ROOT]) * (1.0 + self._errors[ROOT])
        return [whole_kw, *found]

    def plant_kw(self, name: str, power_kw: Floats, stored_kw: Floats = _NONE) -> Floats:
        """Return what a plant feeds in, of powers of shape (..., n) and (..., m)."""
        gross_kw = power_kw[..., self._columns[name]].sum(axis=-1)
        if stored_kw.size:
            gross_kw = gross_kw + stored_kw[..., self._storages[name]].sum(axis=-1)
        return net_kw(gross_kw, self._laws[name])

    def fed_in_kw(self, power_kw: Floats, stored_kw: Floats = _NONE) -> Floats:
        """Return what is fed in together."""
        if self.plants:
            parts = [self.plant_kw(name, power_kw, stored_kw) for name in self.plants]
            gross_kw = np.sum(parts, axis=0)
            stored_kw = stored_kw[..., self._beside] if stored_kw.size else stored_kw
        else:
            gross_kw = power_kw.sum(axis=-1)
        if stored_kw.size:
            gross_kw = gross_kw + stored_kw.sum(axis=-1)
        return net_kw(gross_kw, self._laws[ROOT])

    def available_kw(self, mpp_kw: Floats) -> Floats:
        """Return what could be fed in without storages: of a plant not more than its limit."""
        if not self.plants:
            return self.fed_in_kw(mpp_kw)
        parts = [
            np.clip(self.plant_kw(name, mpp_kw), 0.0, self._laws[name].pmax_kw)
            for name in self.plants
        ]
        return net_kw(np.sum(parts, axis=0), self._laws[ROOT])


def _below(name: str, paths: Sequence[str]) -> list[int]:
    start = f"{name}/" if name else ""  # A plant without clusters may be a column itself.
    return [at for at, path in enumerate(paths) if path == name or path.startswith(start)]
