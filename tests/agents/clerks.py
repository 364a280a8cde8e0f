"""A clerk: an agent that says at the end of each stage what it heard, and a sequencer for it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from plants_by_hand import CYCLE_NS

from agents.agent import Stage, Turn
from agents.late_words import LatePolicy
from agents.sequencer import Sequencer
from bus_schemas.bus import Delivery
from bus_schemas.messages import Dispatch, Help, Message, Notice, Request, Residual, Setpoint
from bus_schemas.signals import DISPATCH, HELP, NOTICE, REQUEST, RESIDUAL, SETPOINT, Port
from bus_schemas.tree import CENTRAL, ROOT

ORDER = DISPATCH.of(ROOT)
A, B = RESIDUAL.of("a"), RESIDUAL.of("b")
HELP_A, HELP_B = HELP.of("a"), HELP.of("b")
ASK, SET = REQUEST.of("a"), SETPOINT.of("a")
SAID = NOTICE.of(ROOT)

LISTEN_TO_BOTH = (Stage("listen", frozenset({A, B}), frozenset({HELP_A, HELP_B})),)
LISTEN_TO_PARENT = (Stage("listen", frozenset({ASK, SET})),)
ORDER_THEN_LISTEN = (
    Stage("order", frozenset({ORDER})),
    Stage("listen", frozenset({A, B}), frozenset({HELP_A, HELP_B})),
)
TICK_THEN_LISTEN = (Stage("tick", frozenset(), timed=True), Stage("listen", frozenset({A})))


@dataclass(frozen=True)
class Clerk:
    """Says at the end of each stage what it heard, and remembers how often it spoke."""

    all_stages: tuple[Stage, ...]
    name: str = CENTRAL

    def initial_state(self) -> int:
        return 0

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        return self.all_stages

    def follow_up(self, port: Port[Message], message: Message) -> Port[Message] | None:
        if isinstance(message, Residual) and message.power_kw < 0.0:
            return HELP.of(port.node)
        return None

    def step(self, state: int, turn: Turn) -> tuple[int, list[Delivery]]:
        heard = " ".join(sorted(_named(port, word, turn) for port, word in turn.inputs.items()))
        text = f"{turn.cycle} {turn.stage}: {heard or 'nothing'}"
        return state + 1, [(SAID, Notice(*turn.stamp, text=text, count=state + 1))]


def _named(port: Port[Message], message: Message, turn: Turn) -> str:
    return str(port) if message.cycle == turn.cycle else f"{port}@{message.cycle}"


class Desk:
    """A clerk in a sequencer, and the messages that reach it."""

    def __init__(
        self,
        stages: tuple[Stage, ...],
        *,
        lockstep: bool = True,
        horizon: int = 2,
        late: LatePolicy = "use",
    ) -> None:
        self.dropped: list[str] = []
        self.sequencer = Sequencer(
            Clerk(stages),
            lambda cycle: cycle * CYCLE_NS,
            lockstep=lockstep,
            horizon=horizon,
            on_drop=self.dropped.append,
            late=late,
        )

    def enter(self, cycle: int) -> list[str]:
        return texts(self.sequencer.enter(cycle))

    def hear(self, port: Port[Message], cycle: int, power_kw: float = 1.0) -> list[str]:
        return texts(self.sequencer.accept(port, a_message(port, cycle, power_kw)))


def a_message(port: Port[Message], cycle: int, power_kw: float = 1.0) -> Message:
    time_ns = cycle * CYCLE_NS
    if port is ORDER:
        return Dispatch(
            cycle, time_ns, "plant", (), power_kw=1.0, commitment_kw=1.0, regulation_kw=0.0
        )
    if port.signal is HELP:
        return Help(cycle, time_ns, port.node, (), missing_kw=1.0)
    if port is ASK:
        return Request(cycle, time_ns, CENTRAL, (), power_kw=power_kw)
    if port is SET:
        return Setpoint(
            cycle, time_ns, CENTRAL, (), power_kw=power_kw, share_kw=power_kw, help_given=()
        )
    return Residual(cycle, time_ns, port.node, (), power_kw=power_kw)


def notices(outputs: Iterable[Delivery]) -> list[Notice]:
    found = [message for _, message in outputs if isinstance(message, Notice)]
    assert all(notice.sim_time_ns == notice.cycle * CYCLE_NS for notice in found)
    return found


def texts(outputs: Iterable[Delivery]) -> list[str]:
    return [notice.text for notice in notices(outputs)]
