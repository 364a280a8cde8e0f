"""The plan of a run: one file that each of its processes reads, so that all agree."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from math import ceil
from typing import Any, Literal

import msgspec
from msgspec.structs import replace

from agents.control.correction import CorrectionLaw, shown_turns
from agents.control.grid import GridLaw
from agents.control.offers import OfferSettings
from agents.control.storage import Pursuit, StorageLaw
from agents.cycle import Deadlines
from agents.faults import ProcessFault
from agents.plan_parts import Access, Control, Faults, PlannedOrder, Site, Supervision, Timing
from agents.settings import FleetPlant, GridSettings, Revert, StorageSettings
from bus_schemas.faults import LinkFault
from bus_schemas.messages import PROTOCOL, Run
from bus_schemas.network_faults import NetworkFaults
from bus_schemas.tree import (
    PLANT,
    ROOT,
    ControlTree,
    agent_name,
    ancestors,
    depth,
)
from bus_schemas.wiring import Links, Wiring


class RunPlan(msgspec.Struct, frozen=True, dict=True, kw_only=True):
    """What the agents of a run share: see the table in docs/wire.md.

    inverters: Path and AC rating [kW] of each inverter.
    storages: The storages beside them.
    grid: What the grid asks of the plant; by default nothing.
    orders: Orders of the scenario, in the order of time.
    plants: The plants of a fleet, each with a meter of its own.
    """

    protocol: int = PROTOCOL
    run_id: str
    plant: str
    inverters: tuple[tuple[str, float], ...]
    timing: Timing
    control: Control
    site: Site = Site()
    access: Access = Access()
    faults: Faults = Faults()
    supervision: Supervision = Supervision()
    grid: GridSettings = GridSettings()
    orders: tuple[PlannedOrder, ...] = ()
    storages: tuple[StorageSettings, ...] = ()
    plants: tuple[FleetPlant, ...] = ()

    @cached_property
    def tree(self) -> ControlTree:
        return ControlTree(
            self.inverters,
            tuple((one.path, one.rating_kw) for one in self.storages),
            tuple((one.name, one.export_limit_kw) for one in self.plants),
        )

    @cached_property
    def storage_laws(self) -> dict[str, StorageLaw]:
        return {one.path: one.law(self.timing.cycle_s) for one in self.storages}

    @property
    def storage_revert(self) -> Revert:
        """What storages do without new commands: by then nobody counts on them any more."""
        return Revert(max(self.control.hold_cycles, 1) * self.timing.cycle_s, to=0.0)

    @cached_property
    def pursuit(self) -> Pursuit:
        """How the inverters together follow what they are asked for, in turns."""
        law, tree, ramp_kw = self.correction_law(), self.tree, 0.0
        for leaf in tree.leaves:
            percent = self.site.settings_of(leaf).ramp_percent_per_s
            share = 1.0 if percent is None else min(percent / 100.0 * law.turn_s, 1.0)
            ramp_kw += share * tree.rating_kw(leaf)
        return Pursuit(ceil(round(law.delay_s / law.turn_s, 6)), ramp_kw)

    @cached_property
    def grid_laws(self) -> dict[str, GridLaw]:
        """What is asked at each meter: that of all, and those of the plants of a fleet."""
        tree, cycle_s = self.tree, self.timing.cycle_s
        found = {ROOT: self.grid.law(tree.rating_kw(ROOT), cycle_s)}
        for one in self.plants:
            turn_s = cycle_s * self.control.periods.cycles[depth(one.name)]
            law = one.grid.law(tree.inverters_kw(one.name), turn_s)
            limits_kw = -tree.storage_kw(one.name), tree.rating_kw(one.name)
            found[one.name] = law._replace(pmin_kw=limits_kw[0], pmax_kw=limits_kw[1])
        return found

    @property
    def grid_law(self) -> GridLaw:
        return self.grid_laws[ROOT]

    def correction_law(self, node: str = ROOT) -> CorrectionLaw:
        """How a target is corrected. Real inverters are read a cycle later, on unknown ramps."""
        site, control, cycle_s = self.site, self.control, self.timing.cycle_s
        leaves = [self.tree.leaves[at] for at in self.tree.leaves_below(node)]
        settings = [site.settings_of(leaf) for leaf in leaves]
        below = {one for one in self.tree.devices if not node or one.startswith(f"{node}/")}
        is_real = bool(site.meter or dict(site.devices).keys() & below)
        delay_s = max(one.delay_s or 0.0 for one in settings) + (cycle_s if is_real else 0.0)
        turn_s = cycle_s * control.periods.cycles[depth(node)]
        is_ramped = any(one.grid.moves_target for one in self.plants)
        return CorrectionLaw(
            is_on=control.correction,
            rating_kw=self.tree.inverters_kw(node) if node else self.tree.rating_kw(ROOT),
            cycle_s=cycle_s,
            turn_s=turn_s,
            delay_s=delay_s,
            is_ramped=is_real
            or is_ramped
            or any(one.ramp_percent_per_s is not None for one in settings),
            offset_kw=0.0 if node else control.offset_kw,
            offset_errors=0.0 if node else control.offset_errors,
            kept_turns=shown_turns(delay_s + 2 * control.hold_cycles * cycle_s, turn_s),
        )

    @cached_property
    def offer_law(self) -> OfferSettings | None:
        # Only an inverter that knows its maximum shows it where it is curtailed; what storages add
        # is shown by the meter.
        is_shown = self.control.actuator == "fraction" or self.site.states_all
        is_seen = is_shown and not self.storages
        offers = self.control.offers
        return None if offers is None else offers.law(self.timing.cycle_s, is_seen=is_seen)

    @cached_property
    def wiring(self) -> Wiring:
        return Wiring(self.plant, self.tree, self._process_of(), devices=self.access.external)

    @cached_property
    def links(self) -> Links:
        return self.wiring.links()

    @cached_property
    def deadlines(self) -> Deadlines:
        return Deadlines(self.tree, self.timing.cycle_wall_ns)

    def network_faults(self) -> NetworkFaults:
        return NetworkFaults(self.link_faults, self.faults.seed, self.tree, self.timing.cycle_ns)

    @property
    def link_faults(self) -> dict[int, LinkFault]:
        """The faults of links, by their numbers among all faults."""
        rules = enumerate(self.faults.rules)
        return {number: one for number, one in rules if not isinstance(one, ProcessFault)}

    @property
    def restarts(self) -> bool:
        lockstep = self.timing.lockstep
        when = self.supervision.restart.when or ("never" if lockstep else "on-failure")
        # In lockstep a parent that acts rarely would lack the messages between its turns.
        return when != "never" and not (lockstep and self.control.periods.longest > 1)

    @property
    def agents(self) -> tuple[str, ...]:
        return tuple(self.wiring.heard)

    @property
    def processes(self) -> tuple[str, ...]:
        return tuple(self.wiring.members)

    def _process_of(self) -> dict[str, str]:
        """Return the process of each agent in a group: the nearest group's on the same host."""
        external, host_of = self.access.external, self.access.addresses.get
        heads = {*self.supervision.groups} - {*external}
        found: dict[str, str] = {}
        for node in self.tree.nodes if heads else ():
            agent = agent_name(node)
            above = map(agent_name, (node, *ancestors(node)))
            head = next((name for name in above if name in heads), agent)
            if agent not in external and host_of(agent) == host_of(head):
                found[agent] = head
        return found

    @cached_property
    def elsewhere(self) -> tuple[str, ...]:
        """Agents that the launcher does not start: devices, and agents on other hosts."""
        away = {*self.access.external, *self.access.addresses}
        return tuple(agent for agent in self.agents if agent in away)

    @property
    def public(self) -> RunPlan:
        """The plan without what the agents of the run prove themselves by."""
        return changed(self, access={"sockets": "", "keys_folder": ""})

    @property
    def bus_namespace(self) -> str:
        return self.access.namespace or self.run_id

    def run_message(self, state: Literal["start", "stop"], cycle: int, start_time_ns: int) -> Run:
        return Run(
            cycle,
            self.timing.sim_time_ns(cycle),
            PLANT,
            (),
            state=state,
            start_time_ns=start_time_ns,
            cycle_wall_ns=self.timing.cycle_wall_ns,
            protocol=self.protocol,
        )

    def as_json(self) -> bytes:
        return msgspec.json.format(msgspec.json.encode(self), indent=1)


def changed(plan: RunPlan, **parts: Mapping[str, Any]) -> RunPlan:
    """Return a plan with other values in its parts: `changed(plan, timing={"cycles": 60})`."""
    return replace(
        plan, **{name: replace(getattr(plan, name), **new) for name, new in parts.items()}
    )
