"""Takes one agent through its cycles: collects the inputs of a stage, closes it, goes on.

A stage closes when all that it awaits has arrived, or when whoever drives it says that its
deadline has passed. The sequencer has neither clock nor bus: it is the same in a process, in
memory and against a recording.

In real time a message may come after its stage has closed. The newest such late word of each port
is kept, and is used where a later message fails to come in time (docs/decisions/0008). What an
agent sends names, in `missing`, what it had to do without, and what took its place
(`bus_schemas.missing`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Generic, TypeVar

from agents.agent import Agent, Stage, Turn
from agents.drops import Cause, DropAccount, Drops
from agents.late_words import LatePolicy, LateWords
from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.missing import SKIPPED, Absence
from bus_schemas.signals import Port, Role

S = TypeVar("S")

BEFORE_ARMING: Final = -(2**31)
"""The cycle that an agent is in before its first message from above: that takes it further."""

_COUNT_IN_ARMING: Final[frozenset[Cause]] = frozenset({"foreign", "other_cycle"})
"""The others do not: rounds overlap while links come up, that is what arming is for."""


class Sequencer(Generic[S]):
    """One agent on its way through the cycles.

    Arming rounds are cycles below 0. Each begins from the initial state and leaves no trace, and a
    message of a later round ends the one under way. From cycle 0 on, cycles follow one another.
    Only what comes from above, from the plant or from its parent, takes an agent into a round or
    into cycle 0: a child that speaks out of turn must not take its parent away from the others.

    Parameters
    ----------
    agent
        The agent.
    sim_time_ns
        Simulated time of a cycle's beginning.
    lockstep
        Whether there is no clock: timed stages close at once.
    horizon
        How many cycles ahead of this agent another one may be. What is further ahead is dropped.
    on_drop
        Called with a line of text for each message that is dropped in the cycles of the run. In
        arming it hears only of those from a stranger and of a cycle far from the round's.
    late
        Whether late words are used in place of what does not come in time, or dropped. In lockstep
        nothing closes before it is complete, so none is ever used.

    Attributes
    ----------
    missing_inputs
        Inputs that were not there at their deadline.
    late_used
        Late words that were used.
    skipped_cycles
        Cycles that were given up because they were over before they began here.
    """

    def __init__(
        self,
        agent: Agent[S],
        sim_time_ns: Callable[[int], int],
        *,
        lockstep: bool,
        horizon: int,
        on_drop: Callable[[str], None] = lambda text: None,
        late: LatePolicy = "use",
    ) -> None:
        self.agent = agent
        self._dropped = DropAccount(on_drop)
        self.cycle = BEFORE_ARMING
        self.end_cycle: int | None = None
        self.missing_inputs = 0
        self.late_used = 0
        self.skipped_cycles = 0
        self._sim_time_ns = sim_time_ns
        self._lockstep = lockstep
        self._horizon = horizon
        self._uses_late = late == "use" and not lockstep
        self._late = LateWords()
        self._state = agent.initial_state()
        self._stages: tuple[Stage, ...] = ()
        self._place = 0
        self._stage_of: dict[Port[Message], int] = {}
        self._known_places: dict[tuple[Stage, ...], dict[Port[Message], int]] = {}
        self._inputs: dict[Port[Message], Message] = {}
        self._ahead: dict[int, list[Delivery]] = {}
        self._absent: tuple[str, ...] = ()
        self._absent_here: list[str] = []
        self._skipped_from: int | None = None
        self._waiting: set[Port[Message]] = set()
        self._deadline_passed = False

    @property
    def drops(self) -> Drops:
        """Messages that it received and did not use, by cause."""
        return self._dropped.drops

    @property
    def dropped_ports(self) -> dict[str, dict[str, int]]:
        """The same by port and cause."""
        return self._dropped.of_ports

    @property
    def waiting_for(self) -> frozenset[Port[Message]]:
        """Ports whose messages the open stage still needs. Empty: no stage is open."""
        return frozenset(self._waiting)

    @property
    def wanted(self) -> int:
        """How many messages the open stage needs at least, 1 or more."""
        return len(self._waiting) or 1

    @property
    def stage(self) -> str:
        """Name of the open stage, empty if none is open."""
        return self._stages[self._place].name if self._place < len(self._stages) else ""

    @property
    def finished(self) -> bool:
        """Whether the run has ended for this agent."""
        return self.end_cycle is not None and self.cycle >= self.end_cycle

    def accept(self, port: Port[Message], message: Message) -> list[Delivery]:
        """Take in a message, and return what the agent sends in answer, if that closes a stage."""
        if not self.is_genuine(port, message):
            return []
        if message.cycle == self.cycle:
            return self._take(port, message)
        if message.cycle < self.cycle:
            self._keep_late(port, message)
            return []
        if self.cycle < 0 and message.cycle <= self._horizon and _is_from_above(port):
            # A later arming round ends the one under way; the run's first message begins cycle 0.
            outputs = self.enter(min(message.cycle, 0))
            return outputs + self.accept(port, message)
        if self._is_near(message.cycle):
            self._keep_ahead(port, message)
        else:
            self._drop("other_cycle", port, self._is_of_another_cycle(port, message))
        return []

    def _is_near(self, cycle: int) -> bool:
        """Whether a cycle to come is so near that its messages are kept.

        In a round those of the next rounds are, but none of the run, which has not begun.
        """
        return cycle <= self.cycle + self._horizon and (cycle < 0 or self.cycle >= 0)

    def _keep_ahead(self, port: Port[Message], message: Message) -> None:
        """Keep a message of a cycle to come: one of each port, however many are sent."""
        held = self._ahead.setdefault(message.cycle, [])
        if any(port is other for other, _ in held):
            self._drop("duplicate", port, f"{port} of cycle {message.cycle} came twice")
        else:
            held.append((port, message))

    def is_genuine(self, port: Port[Message], message: Message) -> bool:
        """Whether a message is from the one who may publish on its port; else it is dropped."""
        if message.source == port.publisher:
            return True
        self._drop("foreign", port, f"{port} of cycle {message.cycle} is from {message.source!r}")
        return False

    def enter(self, cycle: int) -> list[Delivery]:
        """Begin an arming round or cycle 0, from the initial state. The next cycles follow."""
        self._state = self.agent.initial_state()
        self._ahead = {ahead: held for ahead, held in self._ahead.items() if ahead >= cycle}
        self._late = LateWords()
        self._begin(cycle)
        return self._advance()

    def end_before(self, cycle: int) -> None:
        """Let the run end before a cycle: those up to it are still completed."""
        self.end_cycle = cycle
        self._drop_late_at_the_end()

    def close_stage(self) -> list[Delivery]:
        """Close the open stage with what has arrived, because its deadline has passed."""
        if not self.stage:
            return []
        while self._waiting:
            port = self._waiting.pop()
            self.missing_inputs += 1
            late = self._use_late(port)
            if late is None:
                self._absent_here.append(str(port))
            else:
                self._await_announced(port, late)
        self._deadline_passed = True
        return self._advance()

    def catch_up(self, cycle: int) -> list[Delivery]:
        """Give up the cycles before this one, because they are over.

        The open one is brought to its end with what has arrived, if it is under way. Those that
        have not begun are skipped: the agent steps through them without any input, and what it says
        for others to act on is not sent, for it would come too late to be of use. What only states
        what happened, such as the plant's production, is sent for these cycles too. The last cycle
        of a run is never skipped, so that there is one left to say what became of the others.
        """
        outputs: list[Delivery] = []
        if self.cycle < 0 or self._lockstep:
            return outputs
        if self.end_cycle is not None:
            cycle = min(cycle, self.end_cycle - 1)
        while self._place > 0 and self.cycle < cycle:
            outputs += self.close_stage()
        if self.cycle < cycle:
            outputs += self._skip_to(cycle)
            outputs += self._advance()
        return outputs

    def _skip_to(self, cycle: int) -> list[Delivery]:
        outputs: list[Delivery] = []
        # If this cycle was come to by skipping, it has not been able to say so.
        first = self.cycle if self._skipped_from is None else self._skipped_from
        self.skipped_cycles += cycle - self.cycle
        given_up = list(self._inputs.items())
        self._late.not_used(self._inputs)
        while self.cycle < cycle:
            given_up += self._ahead.pop(self.cycle, ())
            outputs += self._pass_over(self.cycle)
            self.cycle += 1
        self._begin(cycle)
        self._skipped_from = first
        self._absent = (str(Absence(SKIPPED, first)),)
        for port, message in given_up:
            self._keep_late(port, message)
        return outputs

    def _pass_over(self, cycle: int) -> list[Delivery]:
        """Step through a skipped cycle, without any input. Returns what nobody acts on."""
        said: list[Delivery] = []
        absent = [str(Absence(SKIPPED, cycle))]
        sim_time_ns = self._sim_time_ns(cycle)
        for stage in self.agent.stages(cycle):
            absent += sorted(map(str, stage.awaits))
            stamp = (cycle, sim_time_ns, self.agent.name, tuple(absent))
            turn = Turn(stage.name, cycle, sim_time_ns, stamp, {})
            self._state, outputs = self.agent.step(self._state, turn)
            said += [(port, word) for port, word in outputs if not port.signal.listeners]
        return said

    def _take(self, port: Port[Message], message: Message) -> list[Delivery]:
        if not self._keep(port, message) or port not in self._waiting:
            return []
        self._waiting.discard(port)
        self._await_announced(port, message)
        return [] if self._waiting else self._advance()

    def _keep(self, port: Port[Message], message: Message) -> bool:
        """Keep a message of this cycle for its stage, if there is one still to come."""
        known = self._inputs.get(port)
        if known is not None and known.cycle == message.cycle:
            self._drop("duplicate", port, f"{port} of cycle {message.cycle} came twice")
        elif self._stage_of.get(port, -1) >= self._place:
            self._inputs[port] = message
            superseded = self._late.came_in_time(port, message.cycle)
            if superseded is not None:
                self._drop_late(port, superseded)
            return True
        elif port in self._stage_of:
            self._keep_late(port, message)
        else:
            self._drop_unexpected(port, message)
        return False

    def _begin(self, cycle: int) -> None:
        """Set up a cycle, with the messages that came ahead of it."""
        self.cycle = cycle
        self._stages = () if self.finished else self.agent.stages(cycle)
        self._stage_of = self._stage_of_port(self._stages)
        self._place = 0
        self._inputs = {}
        self._absent = ()
        self._skipped_from = None
        self._drop_late_at_the_end()
        for port, message in self._ahead.pop(cycle, ()):
            self._keep(port, message)
        self._open_stage()

    def _stage_of_port(self, stages: tuple[Stage, ...]) -> dict[Port[Message], int]:
        """Place of the stage that each port belongs to, worked out once for each kind of cycle."""
        places = self._known_places.get(stages)
        if places is None:
            places = self._known_places[stages] = {
                port: place
                for place, stage in enumerate(stages)
                for port in stage.awaits | stage.on_need
            }
        return places

    def _open_stage(self) -> None:
        """See what the stage still needs; what came early may announce more."""
        self._waiting = set()
        if self._place == len(self._stages):
            return
        awaits = self._stages[self._place].awaits
        self._waiting = set(awaits.difference(self._inputs))
        if len(self._waiting) < len(awaits):
            for port in awaits.intersection(self._inputs):
                self._await_announced(port, self._inputs[port])

    def _await_announced(self, port: Port[Message], message: Message) -> None:
        announced = self.agent.follow_up(port, message)
        if announced is not None and announced not in self._inputs:
            self._waiting.add(announced)

    def _advance(self) -> list[Delivery]:
        """Step the agent on, through stages and cycles, up to a stage that lacks something."""
        outputs: list[Delivery] = []
        while not self._waiting:
            if self._place < len(self._stages):
                stage = self._stages[self._place]
                if stage.timed and self._on_the_clock and not self._deadline_passed:
                    break
                self._deadline_passed = False
                outputs += self._step(stage)
                self._place += 1
                self._open_stage()
            elif self.cycle >= 0 and not self.finished:
                self._begin(self.cycle + 1)
            else:
                break
        return outputs

    @property
    def _on_the_clock(self) -> bool:
        return not self._lockstep and self.cycle >= 0

    def _step(self, stage: Stage) -> list[Delivery]:
        if self._late:
            for port in self._late.any_of(stage.takes_late):
                self._use_late(port)
        if self._absent_here:
            self._absent += tuple(sorted(self._absent_here))
            self._absent_here = []
        sim_time_ns = self._sim_time_ns(self.cycle)
        stamp = (self.cycle, sim_time_ns, self.agent.name, self._absent)
        turn = Turn(stage.name, self.cycle, sim_time_ns, stamp, self._inputs)
        self._state, outputs = self.agent.step(self._state, turn)
        return outputs

    # Late words -----------------------------------------------------------------------------------

    def _keep_late(self, port: Port[Message], message: Message) -> None:
        """Keep a message whose stage has closed, if it says more than what was used or is kept."""
        if not self._uses_late or message.cycle < 0 or self.finished:
            self._drop_late(port, message)
        elif port not in self._stage_of_port(self.agent.stages(message.cycle)):
            self._drop_unexpected(port, message)
        else:
            useless = self._late.keep(port, message)
            if useless is not None:
                self._drop_late(port, useless)

    def _use_late(self, port: Port[Message]) -> Message | None:
        """Put the late word of a port, if there is one, among the inputs of the open stage."""
        message = self._late.take(port)
        if message is not None:
            self._inputs[port] = message
            self._absent_here.append(str(Absence(str(port), message.cycle)))
            self.late_used += 1
        return message

    def _drop_late_at_the_end(self) -> None:
        if self.finished:
            for port, message in self._late.clear():
                self._drop_late(port, message)

    # Drops ----------------------------------------------------------------------------------------

    def _drop_late(self, port: Port[Message], message: Message) -> None:
        if message.cycle == self.cycle:
            text = f"{port} of cycle {message.cycle} came after its deadline"
        else:
            text = self._is_of_another_cycle(port, message)
        self._drop("late", port, text)

    def _is_of_another_cycle(self, port: Port[Message], message: Message) -> str:
        here = "before all cycles" if self.cycle == BEFORE_ARMING else str(self.cycle)
        return f"{port} is of cycle {message.cycle}, this is {here}"

    def _drop_unexpected(self, port: Port[Message], message: Message) -> None:
        self._drop("unexpected", port, f"{port} is not expected in cycle {message.cycle}")

    def _drop(self, cause: Cause, port: Port[Message], text: str) -> None:
        if self.cycle >= 0 or cause in _COUNT_IN_ARMING:
            self._dropped.add(cause, port, text)


def _is_from_above(port: Port[Message]) -> bool:
    """Whether a port's messages come down the tree; the plant takes itself into its rounds."""
    return port.signal.publisher in {Role.PLANT, Role.PARENT}
