"""The central controller, the paper's adaptive layer: the root of the control tree.

request  dispatch from the operator         -> request to each child
solve    impp, residual, help of children   -> the plant's own impp, residual, help;
                                               setpoint to each child
"""

from __future__ import annotations

from math import isfinite

import msgspec
from msgspec.structs import replace

from agents.agent import Stage, Turn
from agents.family import Family, Report
from agents.periods import Periods
from bus_schemas.bus import Delivery
from bus_schemas.messages import Dispatch, Message, Notice
from bus_schemas.signals import DISPATCH, NOTICE, Port
from bus_schemas.tree import CENTRAL, ROOT


class CentralState(msgspec.Struct, frozen=True, gc=False):
    """What a central controller remembers.

    Attributes
    ----------
    dispatched
        Whether there was a dispatch that could be used. Before, nothing is asked of the children,
        and nothing is held back.
    dispatch_kw
        The last dispatch that could be used.
    request_kw
        What was asked of the children in the last turn.
    refused_dispatches
        How many dispatches could not be used as they were.
    reports
        The children's last reports.
    """

    dispatched: bool
    dispatch_kw: float
    request_kw: float
    refused_dispatches: int
    reports: tuple[Report, ...]


class CentralController:
    """Takes the operator's dispatch and moves power between clusters to meet it.

    Parameters
    ----------
    family
        Its children.
    periods
        In which cycles it acts.
    """

    name = CENTRAL

    def __init__(self, family: Family, periods: Periods) -> None:
        self._family = family
        self._periods = periods
        self._dispatch = DISPATCH.of(ROOT)
        self._notice = NOTICE.of(ROOT)
        self._stages = (
            Stage("request", frozenset({self._dispatch})),
            Stage("solve", family.report_ports, family.help_ports),
        )

    def initial_state(self) -> CentralState:
        """Nothing dispatched, nothing reported."""
        return CentralState(False, 0.0, 0.0, 0, self._family.no_reports())

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        """Return the stages: it hears the operator and its children in every cycle."""
        return self._stages

    def follow_up(self, port: Port[Message], message: Message) -> Port[Message] | None:
        """Return the call for help that a child's negative residual announces."""
        return self._family.follow_up(port, message)

    def step(self, state: CentralState, turn: Turn) -> tuple[CentralState, list[Delivery]]:
        """Close a stage."""
        if turn.stage == "request":
            return self._request(state, turn)
        return self._solve(state, turn)

    def _request(self, state: CentralState, turn: Turn) -> tuple[CentralState, list[Delivery]]:
        state, outputs = self._take_dispatch(state, turn)
        if self._periods.is_turn(ROOT, turn.cycle):
            state = replace(state, request_kw=state.dispatch_kw)
            outputs += self._family.requests(turn, state.request_kw)
        return state, outputs

    def _take_dispatch(
        self, state: CentralState, turn: Turn
    ) -> tuple[CentralState, list[Delivery]]:
        """Take up the dispatch; one that makes no sense is refused or clamped, and counted."""
        dispatch = turn.get(self._dispatch)
        if dispatch is None:
            return state, []
        usable_kw, complaint = self._usable_dispatch(dispatch, state)
        if usable_kw is not None:
            state = replace(state, dispatched=True, dispatch_kw=usable_kw)
        if not complaint:
            return state, []
        refused = state.refused_dispatches + 1
        notice = Notice(*turn.stamp, text=complaint, count=refused)
        return replace(state, refused_dispatches=refused), [(self._notice, notice)]

    def _usable_dispatch(self, dispatch: Dispatch, state: CentralState) -> tuple[float | None, str]:
        power_kw, rating_kw = dispatch.power_kw, self._family.rating_kw
        if not isfinite(power_kw):
            text = f"dispatch of {power_kw:g} kW refused, accepted is 0 to {rating_kw:g} kW: "
            if not state.dispatched:
                return None, text + "there was none before it, nothing is held back"
            return None, text + f"{state.dispatch_kw:g} kW still holds"
        if power_kw < 0.0:
            # Regulation downwards may ask for more than there is to take back.
            return 0.0, f"dispatch of {power_kw:.10g} kW clamped to 0 kW"
        if power_kw > rating_kw:
            return (
                rating_kw,
                f"dispatch of {power_kw:.10g} kW clamped to the rating, {rating_kw:.10g} kW",
            )
        return power_kw, ""

    def _solve(self, state: CentralState, turn: Turn) -> tuple[CentralState, list[Delivery]]:
        reports = self._family.listen(turn, state.reports, state.request_kw)
        outputs = self._family.report_up(turn, reports)
        if self._periods.is_turn(ROOT, turn.cycle):
            target_kw = state.dispatch_kw if state.dispatched else self._family.rating_kw
            outputs += self._family.divide(turn, target_kw, reports)
        return replace(state, reports=reports), outputs
