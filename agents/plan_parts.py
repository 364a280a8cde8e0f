"""The parts of a run's plan: timing, control, site, access, faults, supervision, orders."""

from __future__ import annotations

import fnmatch
from functools import cached_property
from math import inf
from typing import Annotated, Final

import msgspec
from msgspec import Meta
from msgspec.structs import asdict, replace

from agents.control.forecast import HIDDEN_ALPHA_MIN
from agents.cycle import Periods
from agents.device_faults import DeviceFault
from agents.device_profile import PLAIN, DeviceProfile
from agents.faults import Fault
from agents.process.machine import MachineSettings
from agents.settings import (
    Actuator,
    InverterSettings,
    OfferedCommitment,
    RestartPolicy,
    Revert,
    Scheme,
    StorageHelp,
)
from bus_schemas.errors import InputError
from bus_schemas.faults import Second
from bus_schemas.messages import Message
from bus_schemas.signals import Occurrence, Port
from bus_schemas.tree import depth, parent_of

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
        return self.cycle_wall_ns == 0

    @property
    def cycle_s(self) -> float:
        return self.cycle_ns / 1e9

    def is_on_clock(self, start_ns: int, now_ns: int) -> bool:
        """Whether the beginning of a run can be by the clock of `now_ns`."""
        return self.lockstep or abs(start_ns - now_ns) <= START_WITHIN_NS

    def sim_time_ns(self, cycle: int) -> int:
        return self.start_time_ns + cycle * self.cycle_ns


class Control(msgspec.Struct, frozen=True, dict=True, kw_only=True):
    """How the controllers decide.

    period_cycles: Period of each tier that has children, the central controller's first.
    hold_cycles: An older input is expired.
    correction: Whether the central controller corrects its target by the plant's meter.
    offset_kw, offset_errors: How much more than the dispatch the plant aims at: a power, and so
        many times its own mean error.
    offers: How the commitment is offered; None: it is given.
    storage: Whether storages help after the inverters, or at once, until these follow.
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
    storage: StorageHelp = "last"

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
        """Return the cycles from one message of a port to the next."""
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

    at: Simulated time since cycle 0 [s].
    power_kw: Power of the plant [kW].
    schedule: Back to the schedule, instead of a power.
    ramp_kw_per_min: Ramp of the dispatch [kW/min]. Default: at once.
    hold_s: Time after which the schedule returns [s]. Default: at the next order.
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
        """Return the cycle under way at its time."""
        return int(self.at / cycle_s + 1e-9)


class Supervision(msgspec.Struct, frozen=True, kw_only=True):
    """How the launcher keeps the processes of a run going.

    groups: Agents that share their process with all agents below them, but those of other groups.
    file_cycles, file_bytes: When the recording goes on in a next file; 0: never.
    """

    restart: RestartPolicy = RestartPolicy()
    groups: tuple[str, ...] = ()
    file_cycles: int = 0
    file_bytes: int = 0
    machine: MachineSettings = MachineSettings()
