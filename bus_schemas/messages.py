"""The message types: one struct for each kind of message.

Every message begins with the same fields (`Message`) and goes on with those of its own kind. Units
are in the field names. On the wire a message is one flat msgpack map from field name to value, so a
reader without this package can take it apart.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Annotated, Final, Literal, NamedTuple, TypeAlias

import msgspec
from msgspec import UNSET, UnsetType

from bus_schemas.tree import LONGEST_PATH, MOST_CHILDREN, MOST_INVERTERS

Stamp: TypeAlias = tuple[int, int, str, tuple[str, ...], int, int, int, int]
"""The head of a message, in the order of its fields. The bus sets publish time and sequence."""

PROTOCOL: Final = 4
"""Version of all that docs/wire.md says. Plan and `run` state it."""

# The largest plant needs less of each.
LONGEST_TEXT: Final = 1_000
MOST_MISSING: Final = 16_384
LONGEST_MISSING: Final = 256

_CYCLE: Final = re.compile(r"0|[1-9][0-9]{0,17}")

# Numbers and texts are bounded, so that whatever comes from elsewhere can be counted with and kept:
# a message with one beyond does not decode.
Cycle: TypeAlias = Annotated[int, msgspec.Meta(gt=-(2**31), lt=10**18)]
SimTime: TypeAlias = Annotated[int, msgspec.Meta(ge=-(2**62), lt=2**62)]
Nanoseconds: TypeAlias = Annotated[int, msgspec.Meta(ge=0, lt=2**62)]
Sequence: TypeAlias = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]
Count: TypeAlias = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]
LongCount: TypeAlias = Annotated[int, msgspec.Meta(ge=0, lt=2**62)]

Name: TypeAlias = Annotated[str, msgspec.Meta(max_length=LONGEST_PATH)]
Entry: TypeAlias = Annotated[str, msgspec.Meta(max_length=LONGEST_MISSING)]
Text: TypeAlias = Annotated[str, msgspec.Meta(max_length=LONGEST_TEXT)]
Powers: TypeAlias = Annotated[tuple[float, ...], msgspec.Meta(max_length=MOST_INVERTERS)]
OfStorage: TypeAlias = float | UnsetType
"""A field that only messages of storages, and of parents of storages, have."""
Expected: TypeAlias = Annotated[tuple[float | None, ...], msgspec.Meta(max_length=10_000)]
OrderState: TypeAlias = Literal["none", "holds", "silent", "over"]
Entries: TypeAlias = Annotated[tuple[Entry, ...], msgspec.Meta(max_length=MOST_MISSING)]


class Message(msgspec.Struct, forbid_unknown_fields=True, gc=False):
    """The head of every message.

    The bus sets `publish_time_ns` and `sequence` as the message goes out. No code changes a message
    after that.

    cycle: The control cycle that the message belongs to. Negative in arming rounds.
    sim_time_ns: Simulated time at the beginning of the cycle, nanoseconds since 1970-01-01 UTC.
    source: Name of the agent that decided it: `plant`, `central`, `recorder` or a node's path. At
        most 200 characters.
    missing: The inputs of the decision that were older than they should have been, so that a
        recording tells which messages an output used. `KEY@CYCLE`: the newest usable message was of
        that earlier cycle. `KEY`: there was none, or it was too old to count. At most 16,384
        entries of up to 256 characters.
    ready_time_ns: Monotonic clock of the sending host when the decision could be made: its last
        awaited input had come, or its deadline had passed.
    publish_time_ns: Monotonic clock of the sending host when the message went out.
    sequence: Number of the message on its key, from 0 in cycle 0 on; 0 in arming rounds. An agent
        that joined a run later counts from 0 again.
    incarnation: The cycle in which the agent's process joined the run: 0, or a later one for a
        process that replaced another. Listeners refuse what comes from a predecessor after that.
    """

    cycle: Cycle
    sim_time_ns: SimTime
    source: Name
    missing: Entries
    ready_time_ns: Nanoseconds = 0
    publish_time_ns: Nanoseconds = 0
    sequence: Sequence = 0
    incarnation: Count = 0


class Head(msgspec.Struct, gc=False):
    """What recorder and readers read of every message, with the bounds of `Message`."""

    cycle: Cycle
    source: Name
    sim_time_ns: SimTime = 0
    publish_time_ns: Nanoseconds = 0
    sequence: Sequence = 0
    incarnation: Count = 0


class Telemetry(Message, kw_only=True):
    """Measurements of an inverter in the interval that just ended, and its limit then.

    `alpha` is the curtailment level it was told. `limit_kw` is the power it did not exceed: its
    rating, or less where the actuator of the run is `limit` and it is curtailed. `available_kw` is
    the power that it could have given, where the inverter states it (SunSpec 122 `WAval`).
    A storage takes power where that is negative; `energy_kwh` is what is stored in it now.
    """

    power_kw: float
    alpha: float
    limit_kw: float
    available_kw: float | None = None
    energy_kwh: OfStorage = UNSET


class Dispatch(Message, kw_only=True):
    """The power that the operator wants from the plant in the coming interval.

    `power_kw` is the paper's P_desired: by the schedule the commitment plus the regulation asked
    for, and otherwise what an order asks for, in steps of its ramp. While it is an order's,
    `regulation_kw` is 0. Every controller hears the dispatch and works out its share (eq. 3) of
    `plant_rating_kw`.

    The fields of `order_...` say which order is the newest one accepted, and what became of it.
    `clear_sky_kw` is the power that the plant would have under a clear sky, in runs with offers.

    `order_source` gave it: `scenario`, `command`, `page`, `modbus` or `operator`; empty if there
    was none yet. `order_state` is `silent` if its source has not renewed it in time, and `over` if
    its time is over and the schedule returns. `order_cycle` is the first cycle with it, and
    `order_renewed` the newest one in which it was renewed. `order_power_kw` is the power as it was
    asked for, before it is clamped to 0 and the rating; nil: back to the schedule. `order_replaced`
    lists the sources of the other orders that came for this cycle: they never came into force.
    """

    power_kw: float
    plant_rating_kw: float
    commitment_kw: float
    regulation_kw: float
    clear_sky_kw: float | None = None
    order_source: Name = ""
    order_state: OrderState = "none"
    order_cycle: Count = 0
    order_renewed: Count = 0
    order_power_kw: float | None = None
    order_ramp_kw_per_min: float | None = None
    order_hold_s: float | None = None
    order_renew_s: float | None = None
    order_replaced: tuple[Name, ...] = ()


class Order(Message, kw_only=True):
    """What the operator orders from the next cycle on.

    `power_kw` is the power of the plant, in place of what the schedule asks for; nil: back to the
    schedule. The dispatch goes there by `ramp_kw_per_min`; nil: at once. The order holds until the
    next one, whoever gives that, or, if it is not renewed, for `hold_s` of simulated time; then the
    schedule returns by the same ramp. A source that has not renewed its order within `renew_s`, as
    it promised, is named as silent.
    """

    power_kw: float | None = None
    ramp_kw_per_min: float | None = None
    hold_s: float | None = None
    renew_s: float | None = None


class Meter(Message, kw_only=True):
    """What the plant fed in during the interval that just ended, by its meter.

    `frequency_hz` is the grid's frequency there and now, where the meter measures it. The other
    fields are those of the newest `memory` of the central controller: a new process of it goes on
    from there. `record` is given only while that process knows fewer intervals.
    """

    power_kw: float
    frequency_hz: float | None = None
    correction_kw: float | None = None
    error_kw: float | None = None
    expected_kw: Expected = ()
    reference_kw: float | None = None
    record: Powers | None = None
    lacking_kw: float | None = None
    tried_kw: float | None = None
    helped_share: float | None = None


class Memory(Message, kw_only=True):
    """What the central controller needs after a restart; the plant gives it back in its `meter`.

    Its correction, the mean error of the plant's power, what the meter should show of its last
    turns (the newest first; nil: that is not known), and the dispatch within the ramp limits.
    `lacking_kw` would be missing without a correction; how much of that is corrected rests on what
    was tried so far, and on the share of it that helped. `intervals` counts the past intervals that
    its offers rest on; `record`, in cycles with an offer, is all that they rest on.
    """

    correction_kw: float
    error_kw: float
    expected_kw: Expected = ()
    reference_kw: float | None = None
    intervals: Count = 0
    record: Powers | None = None
    lacking_kw: float = 0.0
    tried_kw: float = 0.0
    helped_share: float = 0.0


class Impp(Message, kw_only=True):
    """Estimated maximum power of a node: of an inverter (eq. 1), or summed over children (eq. 2).

    `stale_cycles` counts the cycles since the last usable measurement; at a parent it is the
    largest of its children's.

    `discharge_kw` is what a storage can give through the coming cycle, which is its IMPP,
    `absorb_kw` what it can take, and `charge_kw` what of that would bring it back to its target. A
    parent adds them up over the storages below it, apart from the IMPP of its inverters.
    """

    power_kw: float
    stale_cycles: Count
    discharge_kw: OfStorage = UNSET
    absorb_kw: OfStorage = UNSET
    charge_kw: OfStorage = UNSET


class Residual(Message, kw_only=True):
    """IMPP less share (eq. 4). Below 0 it is a deficit, above 0 headroom."""

    power_kw: float


class Help(Message, kw_only=True):
    """A negative residual, for people and recordings."""

    missing_kw: float


class HelpGiven(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """One line of a setpoint's account: `power_kw` more than its share, for the node `needy`."""

    needy: Name
    power_kw: float


class Setpoint(Message, kw_only=True):
    """The power that a child must produce (step 4).

    `share_kw` is the child's share of its parent's target by capacity. The setpoint is below it
    where the child cannot meet it, and above it by the sum of `help_given`. A storage has no share,
    and takes power where its setpoint is negative. `storage_kw` is the part of `power_kw` that the
    storages below a child are to give.
    """

    power_kw: float
    share_kw: float
    help_given: Annotated[tuple[HelpGiven, ...], msgspec.Meta(max_length=MOST_CHILDREN)]
    storage_kw: OfStorage = UNSET


class Command(Message, kw_only=True):
    """What a direct controller commands: the curtailment level alpha (eq. 6).

    `power_kw` says the same in absolute power, IMPP x alpha; the rating where alpha is 1 and
    nothing is to be held back. A run has one actuator: `fraction` inverters apply alpha to their
    true maximum, `limit` inverters hold `power_kw`.

    An inverter that hears nothing more for its revert time goes to the limit `revert_kw` if it is
    set to its share and that is given, else to what is set in it.
    """

    alpha: float
    power_kw: float
    revert_kw: float | None = None


class Offer(Message, kw_only=True):
    """What the plant can promise for a coming interval: `share` of its power under a clear sky.

    The interval is that of the scenario which begins `lead_s` after this cycle. The operator
    accepts every offer: it is the commitment of the interval.
    """

    share: float


class Production(Message, kw_only=True):
    """True power in the interval of this cycle. No controller may listen to it.

    `inverter_mpp_kw` and `inverter_power_kw` list the inverters in the order of the control tree.
    `unknown_kw` is what lost real inverters may give beside `delivered_kw`; it is not measured.
    `storage_power_kw` and `storage_energy_kwh` list the storages: what they gave, negative if they
    took it, and what is stored in them at its end.
    """

    dispatch_kw: float
    available_kw: float
    delivered_kw: float
    inverter_mpp_kw: Powers
    inverter_power_kw: Powers
    unknown_kw: float = 0.0
    storage_power_kw: Powers | UnsetType = UNSET
    storage_energy_kwh: Powers | UnsetType = UNSET


class Run(Message, kw_only=True):
    """Beginning and end of a run.

    At `start`, cycle 0 begins at `start_time_ns` of the host's monotonic clock and a cycle lasts
    `cycle_wall_ns` (0: lockstep, no deadlines). At `stop`, `cycle` is the first cycle that does
    not take place. `protocol` is the version of the wire that the plant speaks, 1 if it
    does not say.
    """

    state: Literal["start", "stop"]
    start_time_ns: Nanoseconds
    cycle_wall_ns: Nanoseconds
    protocol: Count = 1


class Ready(Message, kw_only=True):
    """The recorder has seen every message of this arming round."""


class Notice(Message, kw_only=True):
    """What an agent refused or corrected, in words, and how often so far."""

    text: Text
    count: LongCount


class GivenUp(Message, kw_only=True):
    """Agents that do not come back.

    `agents` are all of them so far. From now on their messages are not awaited, in lockstep either.
    """

    agents: Annotated[tuple[Name, ...], msgspec.Meta(max_length=2 * MOST_INVERTERS)]


class Clock(Message, kw_only=True):
    """Where a replay stands: the simulated time that begins now.

    Comes before the first message of a cycle. `rate` is recorded, or simulated, seconds a second;
    0: as fast as possible.
    """

    rate: float


class Missing(NamedTuple):
    """An entry of `missing`. `cycle` is that of the message used; None if there was none."""

    key: str
    cycle: int | None

    def __str__(self) -> str:
        return self.key if self.cycle is None else f"{self.key}@{self.cycle}"


def parse_missing(entry: str) -> Missing:
    """Take an entry apart. An entry without a valid cycle is a key as a whole."""
    key, at, cycle = entry.rpartition("@")
    return Missing(key, int(cycle)) if at and _CYCLE.fullmatch(cycle) else Missing(entry, None)


def in_words(missing: Iterable[str]) -> str:
    """Say what a decision was based on: `without c1/impp, used c2/impp of cycle 41`."""
    return ", ".join(
        f"without {key}" if used is None else f"used {key} of cycle {used:,}"
        for key, used in map(parse_missing, missing)
    )
