"""The plan of a run: one file that each of its processes reads, so that all agree."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping
from functools import cached_property
from math import inf
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta
from msgspec.structs import asdict, replace

from agents.control.correction import CorrectionLaw, shown_turns
from agents.control.forecast import HIDDEN_ALPHA_MIN
from agents.control.grid import GridLaw
from agents.control.offers import OfferSettings
from agents.cycle import Deadlines, Periods
from agents.device_faults import DeviceFault
from agents.device_profile import PLAIN, DeviceProfile
from agents.faults import Fault, ProcessFault, check_fault
from agents.process.machine import MachineSettings
from agents.settings import (
    Actuator,
    GridSettings,
    InverterSettings,
    OfferedCommitment,
    RestartPolicy,
    Revert,
    Scheme,
)
from bus_schemas.errors import InputError, listed
from bus_schemas.faults import Second
from bus_schemas.messages import PROTOCOL, Message, Run
from bus_schemas.network_faults import NetworkFaults
from bus_schemas.signals import Occurrence, Port
from bus_schemas.tree import (
    OPERATOR,
    PLANT,
    ROOT,
    ControlTree,
    agent_name,
    ancestors,
    check_name,
    depth,
    parent_of,
)
from bus_schemas.wiring import Links, Wiring

LONGEST_CYCLE_NS: Final = 3_600_000_000_000
MOST_CYCLES: Final = 10_000_000
MOST_VALUES: Final = 100_000_000
"""Limits of a run: cycles, and cycles times inverters (0.8 GB for one number of each)."""

START_WITHIN_NS: Final = 10_000_000_000
"""A start time further away than this comes from another host's clock."""


class Neighbourhood(msgspec.Struct, frozen=True):
    """The order of help among a parent's children from a time on.

    from_time_ns: Simulated time from which it holds.
    correlation: Pearson correlation between the children's power, shape (n, n).
    """

    from_time_ns: int
    correlation: tuple[tuple[float, ...], ...]


class NodeNeighbourhoods(msgspec.Struct, frozen=True):
    """The order of help among one parent's children, hour by hour."""

    node: str
    hours: tuple[Neighbourhood, ...]


class Timing(msgspec.Struct, frozen=True, dict=True, kw_only=True):
    """When cycles begin and end, simulated and on the wall clock.

    start_time_ns: Simulated time of cycle 0 [ns since 1970-01-01 UTC].
    cycle_wall_ns: Length of a cycle on the wall clock; 0 is lockstep, without deadlines.
    stall_timeout_s: In lockstep: how long an agent waits before it says for what.
    """

    start_time_ns: int
    cycle_ns: int
    cycles: int
    timezone: str
    cycle_wall_ns: int
    stall_timeout_s: float

    @property
    def lockstep(self) -> bool:
        """Whether cycles close on completeness alone."""
        return self.cycle_wall_ns == 0

    @property
    def cycle_s(self) -> float:
        return self.cycle_ns / 1e9

    def is_on_clock(self, start_ns: int, now_ns: int) -> bool:
        """Whether a time at which a run begins can be of the clock that says now."""
        return self.lockstep or abs(start_ns - now_ns) <= START_WITHIN_NS

    def sim_time_ns(self, cycle: int) -> int:
        """Return the simulated time at the beginning of a cycle, ns since 1970-01-01 UTC."""
        return self.start_time_ns + cycle * self.cycle_ns


class Control(msgspec.Struct, frozen=True, dict=True, kw_only=True):
    """How the controllers decide.

    period_cycles: Period of each tier that has children, the central controller's first.
    hold_cycles: An older input is expired.
    correction: Whether the central controller corrects its target by the plant's meter.
    offset_kw, offset_errors: How much more than the dispatch the plant aims at: a power, and so
        many times its own mean error.
    offers: How the commitment is offered; None: it is given.
    """

    period_cycles: tuple[int, ...]
    scheme: Scheme
    actuator: Actuator
    alpha_min: float
    hold_cycles: int
    neighbourhoods: tuple[NodeNeighbourhoods, ...]
    correction: bool = False
    offset_kw: float = 0.0
    offset_errors: float = 0.0
    offers: OfferedCommitment | None = None

    @cached_property
    def periods(self) -> Periods:
        return Periods(self.period_cycles)

    @cached_property
    def alpha_floor(self) -> float:
        """Lowest curtailment level of any inverter: what everybody knows it cannot go below."""
        return HIDDEN_ALPHA_MIN if self.holds_limits else self.alpha_min

    @property
    def holds_limits(self) -> bool:
        """Whether inverters that are asked for all they have are held near their forecast."""
        return self.scheme == "predictive" and self.actuator == "limit"

    def neighbourhoods_of(self, node: str) -> tuple[Neighbourhood, ...]:
        return next((entry.hours for entry in self.neighbourhoods if entry.node == node), ())

    def period(self, port: Port[Message]) -> int:
        """Return how many cycles there are from one message of a port to the next."""
        if port.signal.occurrence is not Occurrence.TURN:
            return 1
        return self.periods.cycles[depth(parent_of(port.node))]


class Site(msgspec.Struct, frozen=True, kw_only=True):
    """What the inverters do, and what the plant is measured by.

    seed: What random weather is made from.
    regulation_capacity_kw: Power that a regulation signal of +1 stands for; 0: none is offered.
    ramp_limit_percent_per_min: Ramp limit that the run is measured by, in % of the plant's rating.
    available_bias: Relative error of the available power that inverters state; None: none do.
    available_share: Share of the inverters that state it, evenly among them.
    revert: What an inverter does without new commands.
    settings: For each field, the last entry that matches an inverter counts.
    devices: Real inverters, each with its address: `modbus://host:port/unit`.
    meter: Address of the real meter at the point of interconnection; empty: there is none.
    profiles: How some of these want to be read and written, by their nodes; the meter is `meter`.
    positions_m: Metres east and north of a point that is the same for all. Empty: unknown.
    """

    seed: int | None = None
    regulation_capacity_kw: float = 0.0
    ramp_limit_percent_per_min: float | None = None
    available_bias: float | None = None
    available_share: float = 1.0
    revert: Revert = Revert()
    ramp_percent_per_s: float | None = None
    delay_s: float = 0.0
    settings: tuple[InverterSettings, ...] = ()
    devices: tuple[tuple[str, str], ...] = ()
    meter: str = ""
    profiles: tuple[tuple[str, DeviceProfile], ...] = ()
    positions_m: tuple[tuple[float, float], ...] = ()

    @property
    def states_all(self) -> bool:
        """Whether all inverters state their available power."""
        return self.available_bias is not None and self.available_share == 1.0

    def settings_of(self, leaf: str) -> InverterSettings:
        found = InverterSettings(
            revert=self.revert, ramp_percent_per_s=self.ramp_percent_per_s, delay_s=self.delay_s
        )
        for entry in self.settings:
            if fnmatch.fnmatchcase(leaf, entry.nodes):
                given = {name: value for name, value in asdict(entry).items() if value is not None}
                found = replace(found, **given)
        return found

    def revert_of(self, leaf: str) -> Revert:
        revert = self.settings_of(leaf).revert or self.revert
        return revert if self.profile_of(leaf).revert else replace(revert, after_s=inf)

    def profile_of(self, node: str) -> DeviceProfile:
        return dict(self.profiles).get(node, PLAIN)

    def follows_within_s(self, leaf: str) -> float:
        """Return the longest time in which an inverter comes to obey a command [s]."""
        settings = self.settings_of(leaf)
        ramp = settings.ramp_percent_per_s
        return (settings.delay_s or 0.0) + (100.0 / ramp if ramp is not None else 0.0)


class Access(msgspec.Struct, frozen=True, kw_only=True):
    """Where the agents of a run find each other, and what proves who they are.

    namespace: Prefix of the run's keys. Empty: the `run_id`, so that two runs never meet.
    external: Agents that the launcher waits for: the user's own devices.
    tcp_ports: Port of each agent that listens. Empty where no link leaves the host, and in memory.
    sockets: Folder of the sockets on which agents link without keys, which nobody but their user
        can enter; devices connect to `tcp_ports`. Empty: all links are TCP.
    address, addresses: Where the agents listen, and those that run on other hosts.
    keys_folder: Folder of the agents' certificates; empty: the links are not encrypted.
    """

    namespace: str = ""
    external: tuple[str, ...] = ()
    tcp_ports: dict[str, int] = {}
    sockets: str = ""
    address: str = "127.0.0.1"
    addresses: dict[str, str] = {}
    keys_folder: str = ""

    def endpoint(self, process: str) -> str:
        """Where a process listens on the network, as Zenoh writes it."""
        address = self.addresses.get(process, self.address)
        bracketed = f"[{address}]" if ":" in address else address
        protocol = "tls" if self.keys_folder else "tcp"
        return f"{protocol}/{bracketed}:{self.tcp_ports[process]}"


class Faults(msgspec.Struct, frozen=True):
    """Planned faults of links and processes, and the seed of those that are random.

    device: What the device under test hears instead of some messages, see `heliarch conform`.
    """

    rules: tuple[Fault, ...] = ()
    seed: int = 0
    device: tuple[DeviceFault, ...] = ()


class PlannedOrder(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An order that the scenario states.

    at: When, in simulated time since cycle 0 [s].
    power_kw: Power of the plant [kW].
    schedule: Back to the schedule, instead of a power.
    ramp_kw_per_min: Ramp by which the dispatch goes there [kW/min]. Default: at once.
    hold_s: Time after which the schedule returns [s]. Default: the order holds until the next one.
    """

    at: Second
    power_kw: Annotated[float, Meta(ge=0.0, le=1e9)] | None = None
    schedule: bool = False
    ramp_kw_per_min: Annotated[float, Meta(gt=0.0, le=1e12)] | None = None
    hold_s: Annotated[float, Meta(gt=0.0, le=1e12)] | None = None

    def __post_init__(self) -> None:
        if self.schedule == (self.power_kw is not None):
            raise InputError("expected either power_kw or schedule = true")
        if self.schedule and self.hold_s is not None:
            raise InputError.of("hold_s", "expected power_kw with it, got schedule = true")

    def cycle(self, cycle_s: float) -> int:
        """Return the first cycle with it: the one under way at its time."""
        return int(self.at / cycle_s + 1e-9)


class Supervision(msgspec.Struct, frozen=True, kw_only=True):
    """How the launcher keeps the processes of a run going.

    groups: Agents that share their process with all agents below them, but those of other groups.
    """

    restart: RestartPolicy = RestartPolicy()
    groups: tuple[str, ...] = ()
    machine: MachineSettings = MachineSettings()


class RunPlan(msgspec.Struct, frozen=True, dict=True, kw_only=True):
    """What the agents of a run share: see the table in docs/wire.md.

    inverters: Path and AC rating [kW] of each inverter.
    grid: What the grid asks of the plant; by default nothing.
    orders: Orders of the scenario, in the order of time.
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

    @cached_property
    def tree(self) -> ControlTree:
        return ControlTree(self.inverters)

    @cached_property
    def grid_law(self) -> GridLaw:
        return self.grid.law(self.tree.rating_kw(ROOT), self.timing.cycle_s)

    @cached_property
    def correction_law(self) -> CorrectionLaw:
        """How the target is corrected. Real inverters are read a cycle later, on unknown ramps."""
        site, control, cycle_s = self.site, self.control, self.timing.cycle_s
        settings = [site.settings_of(leaf) for leaf in self.tree.leaves]
        is_real = bool(site.devices or site.meter)
        delay_s = max(one.delay_s or 0.0 for one in settings) + (cycle_s if is_real else 0.0)
        turn_s = cycle_s * control.periods.cycles[0]
        return CorrectionLaw(
            is_on=control.correction,
            rating_kw=self.tree.rating_kw(ROOT),
            cycle_s=cycle_s,
            turn_s=turn_s,
            delay_s=delay_s,
            is_ramped=is_real or any(one.ramp_percent_per_s is not None for one in settings),
            offset_kw=control.offset_kw,
            offset_errors=control.offset_errors,
            kept_turns=shown_turns(delay_s + 2 * control.hold_cycles * cycle_s, turn_s),
        )

    @cached_property
    def offer_law(self) -> OfferSettings | None:
        # Only an inverter that knows its maximum shows it where it is curtailed.
        is_seen = self.control.actuator == "fraction" or self.site.states_all
        offers = self.control.offers
        return None if offers is None else offers.law(self.timing.cycle_s, is_seen=is_seen)

    @cached_property
    def wiring(self) -> Wiring:
        return Wiring(
            self.plant,
            self.tree,
            self._process_of(),
            has_operator=self.has_operator,
        )

    @cached_property
    def links(self) -> Links:
        return self.wiring.links()

    @cached_property
    def agent_links(self) -> Links:
        """The links that have no device at either end."""
        devices = {*self.access.external}
        return Links(tuple(pair for pair in self.links.pairs if devices.isdisjoint(pair)))

    @cached_property
    def deadlines(self) -> Deadlines:
        return Deadlines(self.tree, self.timing.cycle_wall_ns)

    def network_faults(self) -> NetworkFaults:
        """Return the faults of the run's links, not yet at work."""
        on_links = {
            number: fault
            for number, fault in enumerate(self.faults.rules)
            if not isinstance(fault, ProcessFault)
        }
        return NetworkFaults(on_links, self.faults.seed, self.tree, self.timing.cycle_ns)

    @property
    def restarts(self) -> bool:
        lockstep = self.timing.lockstep
        when = self.supervision.restart.when or ("never" if lockstep else "on-failure")
        # In lockstep a parent that acts rarely would lack the messages between its turns.
        return when != "never" and not (lockstep and self.control.periods.longest > 1)

    @property
    def has_operator(self) -> bool:
        return OPERATOR in self.access.external

    @property
    def agents(self) -> tuple[str, ...]:
        return (*self.tree.agents(), *((OPERATOR,) if self.has_operator else ()))

    @property
    def processes(self) -> tuple[str, ...]:
        return self.wiring.processes

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


class _Version(msgspec.Struct):
    """What a plan of any version says."""

    protocol: int


def load_plan(path: Path) -> RunPlan:
    try:
        data = path.read_bytes()
        protocol = msgspec.json.decode(data, type=_Version).protocol
        if protocol != PROTOCOL:
            raise InputError.of("protocol", f"expected {PROTOCOL}, got {protocol}")
        plan = msgspec.json.decode(data, type=RunPlan)
        check_plan(plan)
    except (OSError, InputError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected the plan.json of a run, got: {error}") from None
    return plan


def check_size(cycles: int, inverters: int, where: str) -> None:
    """Refuse a run that would take more memory than any machine is asked for."""
    most = min(MOST_CYCLES, MOST_VALUES // inverters)
    if not 0 < cycles <= most:
        raise InputError.of(
            where, f"expected up to {most:,} cycles with {inverters:,} inverters, got {cycles:,}"
        )


def check_plan(plan: RunPlan) -> None:
    for where, name in (("plant", plan.plant), ("run_id", plan.run_id)):
        check_name(name, where)  # Files are named after them.
    check_size(plan.timing.cycles, len(plan.tree.leaves), "cycles")
    access = plan.access
    for number, fault in enumerate(plan.faults.rules):
        check_fault(fault, plan.tree, f"faults[{number}]", access.external, access.addresses)
    _check_groups(plan)
    leaves, height = plan.tree.leaves, plan.tree.height
    if not 0 < plan.timing.cycle_ns <= LONGEST_CYCLE_NS:
        got = f"got {plan.timing.cycle_ns:,}"
        raise InputError.of("cycle_ns", f"expected above 0, up to {LONGEST_CYCLE_NS:,}, {got}")
    _check_orders(plan)
    if plan.control.offers is not None:  # Refuse an interval that is not of whole cycles.
        plan.control.offers.law(plan.timing.cycle_s, is_seen=True)
    for number, entry in enumerate(plan.site.settings):
        if not fnmatch.filter(leaves, entry.nodes):
            known = f"inverters ({listed(leaves)}) or a pattern such as c1/*"
            where = f"plant.settings[{number}].nodes"
            raise InputError.of(where, f"expected {known}, got {entry.nodes!r}")
    periods = len(plan.control.periods.cycles)
    if periods != height:
        raise InputError.of("control.period_cycles", f"expected {height} entries, got {periods}")


def _check_orders(plan: RunPlan) -> None:
    rating_kw, taken = plan.tree.rating_kw(ROOT), set[int]()
    for number, order in enumerate(plan.orders):
        if (order.power_kw or 0.0) > rating_kw:
            expected = f"the plant's rating of {rating_kw:.10g} kW at most"
            got = f"got {order.power_kw:.10g} kW"
            raise InputError(f"orders[{number}].power_kw: expected {expected}, {got}")
        cycle = order.cycle(plan.timing.cycle_s)
        if cycle in taken:
            raise InputError(f"orders[{number}].at: expected a cycle without another order")
        taken.add(cycle)


def _check_groups(plan: RunPlan) -> None:
    parents = [*map(agent_name, plan.tree.parents)]
    for group in plan.supervision.groups:
        if group not in parents:
            raise InputError.of("processes", f"expected any of {listed(parents)}, got {group!r}")
