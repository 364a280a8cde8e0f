"""The bus of a verification: an agent hears what it used when the run was recorded."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from agents.agent import Stage
from agents.plan import RunPlan
from bus_schemas.bus import Arrival, Delivery
from bus_schemas.memory_bus import VirtualClock
from bus_schemas.messages import Message
from bus_schemas.missing import parse_missing
from bus_schemas.signals import Port
from recordings.verify.recorded_cycles import RecordedCycle


class RecentMessages:
    """The newest messages of each port: as many as an agent can still use.

    Parameters
    ----------
    plan
        Of the recorded run.

    Attributes
    ----------
    of_port
        Messages of each port by their cycle; of several in one cycle the first.
    """

    def __init__(self, plan: RunPlan) -> None:
        self.of_port: dict[Port[Message], dict[int, Message]] = {
            port: {} for port in plan.keys.ports
        }
        self._most = plan.hold_cycles + 2
        self._repeated: dict[Port[Message], int] = {}

    def add(self, cycle: RecordedCycle) -> None:
        """Take in the messages of the next cycle."""
        number, most = cycle.number, self._most
        for port, message in cycle.messages.items():
            kept = self.of_port[port]
            kept[number] = message
            if len(kept) > most:
                del kept[next(iter(kept))]
        for port, _ in cycle.repeated:
            self._repeated[port] = number

    def were_repeated(self, ports: Iterable[Port[Message]]) -> bool:
        """Whether one of some ports had several messages in a cycle that can still be used."""
        if not self._repeated:
            return False
        return any(self._repeated.get(port) in self.of_port[port] for port in ports)


class RecordingBus:
    """One agent's place on the bus of a recorded run.

    It brings the messages that the agent used, and keeps those that the agent publishes. The clock
    jumps to each deadline, so a stage closes with what it used, whether that was complete or not.

    Parameters
    ----------
    agent
        Name of the agent.
    plan
        Of the recorded run.
    recent
        What all agents published.
    clock
        Set to the deadlines.

    Attributes
    ----------
    published
        What the agent has published since `bring`.
    """

    def __init__(
        self, agent: str, plan: RunPlan, recent: RecentMessages, clock: VirtualClock
    ) -> None:
        self.published: list[Delivery] = []
        self._agent = agent
        self._plan = plan
        self._recent = recent
        self._clock = clock
        self._newest = dict.fromkeys(plan.wiring.heard.get(agent, ()), -1)
        self._inputs: dict[Stage, tuple[tuple[Port[Message], int], ...]] = {}
        self._arriving: list[Delivery] = []

    def bring(
        self, stage: Stage, cycle: int, missing: Sequence[str]
    ) -> tuple[list[Delivery], list[Port[Message]]]:
        """Let the messages arrive that a stage used: those that were due, but for its `missing`.

        Returns
        -------
        tuple
            The messages that the agent has not heard yet, and the ports on which the recording
            lacks the one that was used.
        """
        used_of = dict(map(parse_missing, missing)) if missing else None
        newest, of_port = self._newest, self._recent.of_port
        arriving: list[Delivery] = []
        lacking: list[Port[Message]] = []
        for port, period in self._inputs_of(stage):
            used: int | None = cycle if period == 1 else cycle - cycle % period
            if used_of is not None:
                used = used_of.get(str(port), used)
            if used is None or newest[port] >= used:
                continue
            message = of_port[port].get(used)
            if message is None:
                lacking.append(port)
            else:
                newest[port] = used
                arriving.append((port, message))
        self.published = []
        self._arriving = arriving
        return arriving, lacking

    def _inputs_of(self, stage: Stage) -> tuple[tuple[Port[Message], int], ...]:
        """Return ports and periods of a stage's inputs; what it awaits comes last."""
        inputs = self._inputs.get(stage)
        if inputs is None:
            ports = dict.fromkeys((*stage.uses, *stage.awaits))
            inputs = tuple((port, self._plan.period(port)) for port in ports)
            self._inputs[stage] = inputs
        return inputs

    def publish(self, port: Port[Message], message: Message, now_ns: int) -> None:
        """Keep a message."""
        self.published.append((port, message))

    def receive(self, until_ns: int | None, wanted: int = 1) -> Sequence[Arrival]:
        """Return what arrives, at the deadline of the open stage."""
        clock, agent = self._clock, self._agent
        if until_ns is not None and until_ns > clock.now_ns:
            clock.now_ns = until_ns
        arriving, self._arriving = self._arriving, []
        return [Arrival(agent, port, message, clock.now_ns) for port, message in arriving]
