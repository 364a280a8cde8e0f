"""The supervisor: one for each cluster, at any tier between the central controller and inverters.

request  request from its parent            -> request to each child
report   impp, residual, help of children   -> impp, residual, help of the cluster
solve    setpoint from its parent           -> setpoint to each child
"""

from __future__ import annotations

import msgspec
from msgspec.structs import replace

from agents.agent import Stage, Turn, parents_word_kw
from agents.family import Family, Report
from agents.periods import Periods
from bus_schemas.bus import Delivery
from bus_schemas.messages import Message
from bus_schemas.signals import REQUEST, SETPOINT, Port
from bus_schemas.tree import parent_of


class SupervisorState(msgspec.Struct, frozen=True, gc=False):
    """Its parent's last words [kW] and its children's last reports."""

    request_kw: float
    target_kw: float
    reports: tuple[Report, ...]


class Supervisor:
    """Settles need and headroom within its cluster, and asks its parent for what remains.

    Parameters
    ----------
    family
        Its children.
    periods
        In which cycles it and its parent act.
    """

    def __init__(self, family: Family, periods: Periods) -> None:
        self.name = family.node
        self._family = family
        self._periods = periods
        self._request = REQUEST.of(self.name)
        self._setpoint = SETPOINT.of(self.name)
        report = Stage("report", family.report_ports, family.help_ports)
        self._full_cycle = (
            Stage("request", frozenset({self._request})),
            report,
            Stage("solve", frozenset({self._setpoint})),
        )
        self._own_turn = (
            Stage("request", frozenset(), takes_late=frozenset({self._request})),
            report,
            Stage("solve", frozenset(), takes_late=frozenset({self._setpoint})),
        )
        self._between_turns = (Stage("request", frozenset()), report, Stage("solve", frozenset()))

    def initial_state(self) -> SupervisorState:
        """Nothing asked, nothing reported."""
        return SupervisorState(0.0, self._family.rating_kw, self._family.no_reports())

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        """Return the stages; between its parent's turns the last request and target hold."""
        if self._periods.is_turn(parent_of(self.name), cycle):
            return self._full_cycle
        return self._own_turn if self._periods.is_turn(self.name, cycle) else self._between_turns

    def follow_up(self, port: Port[Message], message: Message) -> Port[Message] | None:
        """Return the call for help that a child's negative residual announces."""
        return self._family.follow_up(port, message)

    def step(self, state: SupervisorState, turn: Turn) -> tuple[SupervisorState, list[Delivery]]:
        """Close a stage."""
        match turn.stage:
            case "request":
                return self._pass_request_down(state, turn)
            case "report":
                reports = self._family.listen(turn, state.reports, state.request_kw)
                return replace(state, reports=reports), self._family.report_up(turn, reports)
            case _:
                return self._solve(state, turn)

    def _pass_request_down(
        self, state: SupervisorState, turn: Turn
    ) -> tuple[SupervisorState, list[Delivery]]:
        request_kw = parents_word_kw(
            turn.get(self._request), state.request_kw, self._family.rating_kw
        )
        outputs = self._family.requests(turn, request_kw) if self._acts(turn) else []
        return replace(state, request_kw=request_kw), outputs

    def _solve(self, state: SupervisorState, turn: Turn) -> tuple[SupervisorState, list[Delivery]]:
        target_kw = parents_word_kw(
            turn.get(self._setpoint), state.target_kw, self._family.rating_kw
        )
        outputs = self._family.divide(turn, target_kw, state.reports) if self._acts(turn) else []
        return replace(state, target_kw=target_kw), outputs

    def _acts(self, turn: Turn) -> bool:
        return self._periods.is_turn(self.name, turn.cycle)
