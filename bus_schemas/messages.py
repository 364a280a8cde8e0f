"""The message types: one frozen struct for each kind of thing that travels on the bus.

Every message begins with the same head (which cycle, what simulated time, who says it, which
inputs it had to do without, when it was published, its number on its key) and goes on with the
fields of its own kind. Units stand in the field names. On the wire a message is one flat msgpack
map from field name to value, so a reader without this package can still take it apart.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal, TypeAlias

import msgspec

from bus_schemas.tree import LONGEST_PATH

Stamp: TypeAlias = tuple[int, int, str, tuple[str, ...]]
"""The first fields of a message, known before an agent decides: cycle, time, source, missing."""


MOST_MISSING: Final = 4_096
"""Entries of `missing` at most: the largest tree has fewer inputs at any of its agents."""

LONGEST_MISSING: Final = 256
"""Characters of an entry at most: the longest path, a signal and a cycle take fewer."""

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
Entries: TypeAlias = Annotated[tuple[Entry, ...], msgspec.Meta(max_length=MOST_MISSING)]


class Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True, gc=False):
    """The head that every message carries.

    Attributes
    ----------
    cycle
        The control cycle that the message belongs to. Negative in arming rounds.
    sim_time_ns
        Simulated time at the beginning of the cycle, nanoseconds since 1970-01-01 UTC.
    source
        Name of the agent that decided it: `plant`, `central`, `recorder` or a node's path. At most
        200 characters.
    missing
        Keys of the inputs that the sender expected in this cycle and had to do without, so that a
        recording tells which inputs an output used. `KEY@CYCLE`: it used the late word of that
        cycle in its place. `skipped@CYCLE`: it gave up its own cycles from that one on. Always
        empty in lockstep. At most 4,096 entries of up to 256 characters.
    publish_time_ns
        Monotonic clock of the sending host when the message went out. Set by the bus.
    sequence
        Number of the message on its key, from 0 in cycle 0 on; 0 in arming rounds. Set by the bus.
    """

    cycle: Cycle
    sim_time_ns: SimTime
    source: Name
    missing: Entries
    publish_time_ns: Nanoseconds = 0
    sequence: Sequence = 0


class Telemetry(Message, kw_only=True, frozen=True):
    """What an inverter measured in the interval that just ended, and what it obeyed in it.

    `alpha` is the curtailment level it was told. `limit_kw` is the power it did not exceed: its
    rating, or less where the actuator of the run is `limit` and it is curtailed.
    """

    power_kw: float
    alpha: float
    limit_kw: float


class Dispatch(Message, kw_only=True, frozen=True):
    """The power that the operator wants from the plant in the coming interval.

    `power_kw` is the paper's P_desired: the commitment plus the regulation asked for.
    """

    power_kw: float
    commitment_kw: float
    regulation_kw: float


class Request(Message, kw_only=True, frozen=True):
    """The power that a parent asks of a child before it knows who can give it (eq. 3)."""

    power_kw: float


class Impp(Message, kw_only=True, frozen=True):
    """Estimated maximum power of a node: of an inverter (eq. 1), or summed over children (eq. 2).

    `stale_cycles` counts the cycles since the last usable measurement; at a parent it is the
    largest of its children's.
    """

    power_kw: float
    stale_cycles: Count


class Residual(Message, kw_only=True, frozen=True):
    """IMPP less request (eq. 4). Negative: the node needs help."""

    power_kw: float


class Help(Message, kw_only=True, frozen=True):
    """Sent when, and only when, the residual is negative: the power that the node lacks."""

    missing_kw: float


class HelpGiven(msgspec.Struct, frozen=True, array_like=True, gc=False):
    """One line of a setpoint's account: `power_kw` more than its share, for the node `needy`."""

    needy: str
    power_kw: float


class Setpoint(Message, kw_only=True, frozen=True):
    """The power that a child must produce (step 4).

    `share_kw` is the child's share of its parent's target by capacity. The setpoint is below it
    where the child cannot meet it, and above it by the sum of `help_given`.
    """

    power_kw: float
    share_kw: float
    help_given: tuple[HelpGiven, ...]


class Command(Message, kw_only=True, frozen=True):
    """What a direct controller tells its inverter: the curtailment level alpha (eq. 6).

    `power_kw` says the same in absolute power, IMPP x alpha; the rating where alpha is 1, since
    nothing is to be held back. A run has one actuator: `fraction` inverters apply alpha to their
    true maximum, `limit` inverters hold `power_kw`.
    """

    alpha: float
    power_kw: float


class Production(Message, kw_only=True, frozen=True):
    """What really happened in the interval of this cycle. No controller may listen to it.

    `inverter_mpp_kw` and `inverter_power_kw` list the inverters in the order of the control tree.
    """

    desired_kw: float
    possible_kw: float
    delivered_kw: float
    inverter_mpp_kw: tuple[float, ...]
    inverter_power_kw: tuple[float, ...]


class Run(Message, kw_only=True, frozen=True):
    """Beginning and end of a run, for everybody.

    At `start`, cycle 0 begins at `start_time_ns` of the host's monotonic clock and a cycle lasts
    `cycle_wall_ns` (0: lockstep, no deadlines). At `stop`, `cycle` is the first cycle that does
    not take place.
    """

    state: Literal["start", "stop"]
    start_time_ns: Nanoseconds
    cycle_wall_ns: Nanoseconds


class Ready(Message, kw_only=True, frozen=True):
    """The recorder has seen every message of this arming round."""


class Notice(Message, kw_only=True, frozen=True):
    """Something that an agent had to refuse or to mend, in words, with how often it did so far."""

    text: str
    count: LongCount


class Clock(Message, kw_only=True, frozen=True):
    """Where the replay of a recording stands: the simulated time that begins now.

    Comes before the first message of a cycle, and when the replay pauses, goes on, seeks or
    changes its rate. `rate` is recorded, or simulated, seconds a second; 0: as fast as possible.
    """

    rate: float
    paused: bool


class Timing(Message, kw_only=True, frozen=True):
    """What a process in real time has counted of itself since cycle 0.

    The process says it, not the agent in it: it decides nothing, and no agent hears it.

    Attributes
    ----------
    missed_deadlines
        Stages whose deadline passed with inputs absent.
    missing_inputs
        Inputs that were absent then.
    late_used
        Messages of an earlier cycle that were used in place of absent ones.
    overruns
        Stages that closed later than they had to by the process's own fault.
    dropped
        Messages that came in and could not be used.
    slowest_decision_ns
        Longest time from the moment at which a stage could close to its last message sent.
    """

    missed_deadlines: Count
    missing_inputs: Count
    late_used: Count
    overruns: Count
    dropped: Count
    slowest_decision_ns: Nanoseconds

    @property
    def counts(self) -> tuple[int, ...]:
        """What is counted, without what is measured."""
        return (
            self.missed_deadlines,
            self.missing_inputs,
            self.late_used,
            self.overruns,
            self.dropped,
        )
