"""The simulated storages of a plant: they obey their commands within what is stored in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from agents.control.storage import StorageLaw, moved
from agents.plan import RunPlan
from bus_schemas.messages import Command
from sim_plant import whole_cycles


class Store(NamedTuple):
    """A storage at the end of a cycle.

    power_kw: What it gave in the cycle; negative: it took it.
    ordered_kw: Its commands of the last cycles, the newest first: as many as its delay, and one.
    renewed: Cycle of its last command.
    """

    energy_kwh: float
    power_kw: float
    ordered_kw: tuple[float, ...]
    renewed: int = 0


class Storages:
    """The storages of a plan, in its order.

    One that has heard no command for as long as its parents hold inputs goes to 0 kW: from then on
    nobody counts on it.
    """

    def __init__(self, plan: RunPlan) -> None:
        self._settings, cycle_s = plan.storages, plan.timing.cycle_s
        self.laws: tuple[StorageLaw, ...] = tuple(plan.storage_laws.values())
        self.delay_cycles = [int(whole_cycles(one.delay_s, cycle_s)) for one in self._settings]
        self._revert_cycles = round(plan.storage_revert.after_s / cycle_s)

    def at_rest(self) -> tuple[Store, ...]:
        """Return the storages before a run."""
        return tuple(
            Store(one.state * one.capacity_kwh, 0.0, (0.0,) * (delay + 1))
            for one, delay in zip(self._settings, self.delay_cycles, strict=True)
        )

    def obey(
        self,
        stores: Sequence[Store],
        commands: Sequence[Command | None],
        is_tripped: Sequence[bool],
        cycle: int,
        passed: int,
    ) -> tuple[Store, ...]:
        """Go on to a cycle; `passed` is more than 1 after cycles that were missed.

        In an arming round nothing is stored and nothing given.
        """
        if cycle < 0:
            return tuple(stores)
        found = []
        for store, command, tripped, law in zip(
            stores, commands, is_tripped, self.laws, strict=True
        ):
            wanted_kw, renewed = store.ordered_kw[0], store.renewed
            if command is not None and command.cycle >= renewed:
                wanted_kw, renewed = command.power_kw, command.cycle
            meanwhile = (store.ordered_kw[0],) * min(passed - 1, len(store.ordered_kw))
            ordered = (wanted_kw, *meanwhile, *store.ordered_kw)[: len(store.ordered_kw)]
            if cycle - renewed >= self._revert_cycles:
                ordered = (0.0,) * len(ordered)
            energy_kwh, power_kw = store.energy_kwh, store.power_kw
            for _ in range(passed):
                last_kw = 0.0 if tripped else power_kw
                power_kw, energy_kwh = moved(
                    energy_kwh, last_kw, 0.0 if tripped else ordered[-1], law
                )
            found.append(Store(energy_kwh, power_kw, ordered, renewed))
        return tuple(found)
