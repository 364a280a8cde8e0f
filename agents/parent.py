"""The parents: supervisors, and the central controller (the paper's adaptive layer) at the root.

report  impp, residual of the children -> impp, residual, help of the node
solve   setpoint of its own parent     -> setpoint for each child

The central controller does both in its one stage, and has its target from the dispatch.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan, nan
from operator import itemgetter
from typing import Final, NamedTuple

import numpy as np
from msgspec import UNSET
from msgspec.structs import replace

from agents.agent import Stage, Turn
from agents.control.allocation import allocate, help_order, total
from agents.control.correction import nothing_metered
from agents.control.fleet import feedable_ability, feedable_kw
from agents.control.grid import GridLaw, desired_kw, net_kw, ramped_kw, response_kw
from agents.control.offers import (
    OfferSettings,
    known_intervals,
    memory_of,
    nothing_offered,
    observe,
)
from agents.control.share import usable_dispatch_kw
from agents.control.storage import (
    AT_ONCE,
    NO_ABILITY,
    Ability,
    Course,
    Pursuit,
    asked_kw,
    next_course,
    parts_kw,
    storage_kw,
)
from agents.dispatch import own_report, own_share_kw
from agents.feedback import Feedback, MeterState
from agents.plan_parts import Control
from bus_schemas.bus import Delivery
from bus_schemas.messages import (
    HelpGiven,
    Impp,
    Message,
    Meter,
    Notice,
    Offer,
    Residual,
    Setpoint,
)
from bus_schemas.signals import (
    DISPATCH,
    IMPP,
    MEMORY,
    METER,
    NOTICE,
    OFFER,
    RESIDUAL,
    SETPOINT,
    Port,
)
from bus_schemas.tree import ROOT, ControlTree, agent_name, parent_of

_DISPATCH: Final = DISPATCH.of(ROOT)


class Report(NamedTuple):
    """What a parent knows of a child: of an expired one its own share, and nothing beyond it."""

    impp_kw: float
    residual_kw: float
    stale_cycles: int
    is_expired: bool = False


@dataclass(frozen=True, slots=True)
class _Child:
    path: str
    rating_kw: float
    sharing_kw: float
    impp: Port[Impp]
    residual: Port[Residual]
    setpoint: Port[Setpoint]


class Parent:
    """What all parents do: collect the reports of their children, and divide a target."""

    may_skip = True

    def __init__(self, node: str, tree: ControlTree, control: Control) -> None:
        self.name = agent_name(node)
        below = tuple(
            _Child(
                path,
                tree.rating_kw(path),
                tree.sharing_kw(path),
                IMPP.of(path),
                RESIDUAL.of(path),
                SETPOINT.of(path),
            )
            for path in tree.children(node)
        )
        self._children = tuple(child for child in below if not tree.is_storage(child.path))
        self._stores = tuple(child for child in below if tree.storage_kw(child.path))
        self._ratings_kw = tuple(child.rating_kw for child in self._children)
        self._sharing_kw = tree.sharing_kw(node)
        self._node = node
        self._inputs: tuple[Port[Message], ...] = (
            *(port for child in below for port in (child.impp, child.residual)),
            _DISPATCH,
        )
        self._control = control
        hours = control.neighbourhoods_of(node)
        alike = [[0.0] * len(self._children)] * len(self._children)
        self._orders = [(hour.from_time_ns, help_order(hour.correlation)) for hour in hours] or [
            (0, help_order(alike))
        ]

    def reports(self, turn: Turn, target_kw: float = 0.0) -> list[Report]:
        """Return what each child reports.

        The inverters of an expired child serve their own shares, since they do not hear of
        setpoints either; of a target, if there is one, where the dispatch has expired too. A
        residual counts only if it belongs to the same cycle as the IMPP.
        """
        dispatch = turn.get(_DISPATCH)
        reports = []
        for child in self._children:
            impp, residual = turn.get(child.impp), turn.get(child.residual)
            share_kw = own_share_kw(dispatch, child.sharing_kw)
            if share_kw is None:
                share_kw = target_kw * (child.sharing_kw / self._sharing_kw)
            if impp is None:
                expired = self._control.hold_cycles + 1
                reports.append(Report(share_kw, 0.0, expired, is_expired=True))
                continue
            left_kw = impp.power_kw - share_kw
            if residual is not None and residual.cycle == impp.cycle:
                left_kw = residual.power_kw
            stale_cycles = impp.stale_cycles + turn.cycle - impp.cycle
            reports.append(Report(impp.power_kw, left_kw, stale_cycles))
        return reports

    def abilities(self, turn: Turn) -> tuple[Ability, ...]:
        """Return what the storages at or below each child that has some can do."""
        return tuple(map(_ability, (turn.get(child.impp) for child in self._stores)))

    def report_up(
        self, turn: Turn, reports: list[Report], grid: GridLaw | None = None
    ) -> list[Delivery]:
        """State the sums over the children (eq. 2); with a grid, what of them may be fed in."""
        impp_kw = total([report.impp_kw for report in reports])
        left_kw = total([report.residual_kw for report in reports])
        stale_cycles = max(report.stale_cycles for report in reports)
        able = together(self.abilities(turn)) if self._stores else None
        if grid is not None:
            able = None if able is None else feedable_ability(impp_kw, able, grid)
            impp_kw = feedable_kw(impp_kw, grid)
            left_kw = impp_kw - (own_share_kw(turn.get(_DISPATCH), self._sharing_kw) or 0.0)
        return own_report(self._node, turn, impp_kw, stale_cycles, left_kw, able)

    def setpoints(
        self, turn: Turn, target_kw: float, reports: list[Report], of_stores: Sequence[float] = ()
    ) -> list[Delivery]:
        """Divide a target (step 4): return a setpoint for each child.

        `target_kw` is what the inverters are to give, `of_stores` the storages of each child that
        has some.
        """
        expired_kw = total([report.impp_kw for report in reports if report.is_expired])
        later = bisect_right(self._orders, turn.sim_time_ns, key=itemgetter(0))
        _, order = self._orders[max(later - 1, 0)]
        power_kw, share_kw, donors, needy, given_kw = allocate(
            max(target_kw - expired_kw, 0.0),
            self._ratings_kw,
            [0.0 if report.is_expired else report.impp_kw for report in reports],
            self._control.alpha_floor,
            order,
            self._control.scheme == "predictive",
        )
        help_given: list[tuple[HelpGiven, ...]] = [()] * len(self._children)
        for donor, asking, kw in zip(donors, needy, given_kw, strict=True):
            help_given[donor] += (HelpGiven(self._children[asking].path, kw),)
        found = {
            child.setpoint: Setpoint(
                *turn.stamp,
                power_kw=report.impp_kw if report.is_expired else power,
                share_kw=share,
                help_given=given,
            )
            for child, report, power, share, given in zip(
                self._children, reports, power_kw, share_kw, help_given, strict=True
            )
        }
        for child, kw in zip(self._stores, of_stores, strict=True):
            if setpoint := found.get(child.setpoint):
                setpoint.power_kw += kw
                setpoint.storage_kw = kw
            else:
                storage = Setpoint(*turn.stamp, power_kw=kw, share_kw=0.0, help_given=())
                found[child.setpoint] = storage
        return [*found.items()]


def _ability(impp: Impp | None) -> Ability:
    """Return what storages can do whose own report, or whose cluster's, is this."""
    if impp is None:
        return NO_ABILITY
    stated_kw = impp.discharge_kw, impp.absorb_kw, impp.charge_kw
    powers_kw = [kw for kw in stated_kw if kw is not UNSET]
    return Ability(*powers_kw) if len(powers_kw) == len(stated_kw) else NO_ABILITY


def together(abilities: Sequence[Ability]) -> Ability:
    return Ability(*(total(kws) for kws in zip(*abilities, strict=True)))


def _parts_kw(power_kw: float, abilities: Sequence[Ability]) -> list[float]:
    discharge_kw = [able.discharge_kw for able in abilities]
    return parts_kw(power_kw, discharge_kw, [able.absorb_kw for able in abilities])


class Supervisor(Parent):
    """Balances need and headroom within its cluster, and asks its parent for the rest."""

    def __init__(
        self, node: str, tree: ControlTree, control: Control, feedback: Feedback | None = None
    ) -> None:
        super().__init__(node, tree, control)
        self._feedback, self._meter = feedback, METER.of(node)
        self._setpoint = SETPOINT.of(node)
        report = Stage("report", (*self._inputs, *((self._meter,) if feedback else ())))
        self._with_parent = (report, Stage("solve", (self._setpoint,), report.awaits))
        self._alone = (report, Stage("solve", (), (self._setpoint, *report.awaits)))

    def initial_state(self) -> MeterState | None:
        """Return nothing without a meter: the newest messages are all that is needed."""
        return MeterState(nothing_metered(self._feedback.law)) if self._feedback else None

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        """Return the stages; between its parent's turns the newest setpoint holds."""
        if not self._control.periods.acts(self.name, cycle):
            return self._alone[:1]
        parent_acts = self._control.periods.acts(parent_of(self.name), cycle)
        return self._with_parent if parent_acts else self._alone

    def step(
        self, state: MeterState | None, turn: Turn
    ) -> tuple[MeterState | None, list[Delivery]]:
        feedback = self._feedback
        if turn.stage == "report":
            if feedback is None or state is None:
                return None, self.report_up(turn, self.reports(turn))
            meter = turn.get(self._meter)
            state = feedback.read(feedback.recalled(state, meter), meter)
            outputs = self.report_up(turn, self.reports(turn), feedback.grid)
            return state, [*outputs, (MEMORY.of(self._node), feedback.memory(state, turn))]
        setpoint = turn.get(self._setpoint)
        share_kw = own_share_kw(turn.get(_DISPATCH), self._sharing_kw)
        target_kw = share_kw if setpoint is None else setpoint.power_kw
        if target_kw is None:
            return state, []
        reports = self.reports(turn, target_kw)
        if feedback is not None and state is not None:
            state, target_kw = self._metered_kw(state, turn, feedback, target_kw, reports)
        if not self._stores:
            return state, self.setpoints(turn, target_kw, reports)
        of_stores = self._of_stores(turn, setpoint, target_kw, reports)
        return state, self.setpoints(
            turn, max(target_kw - total(of_stores), 0.0), reports, of_stores
        )

    def _metered_kw(
        self,
        state: MeterState,
        turn: Turn,
        feedback: Feedback,
        asked_kw: float,
        reports: list[Report],
    ) -> tuple[MeterState, float]:
        """Return what the plant's inverters and storages are to give for a power at its meter."""
        reference_kw = ramped_kw(state.reference_kw, asked_kw, feedback.grid)
        able_kw = together(self.abilities(turn)).discharge_kw if self._stores else 0.0
        impp_kw = total([one.impp_kw for one in reports])
        with_stores_kw = net_kw(impp_kw + able_kw, feedback.grid)
        wanted_kw = desired_kw(reference_kw, 0.0, with_stores_kw, feedback.grid)
        late = min(one.stale_cycles for one in reports) + turn.cycle - state.meter_cycle
        state = replace(state, reference_kw=reference_kw)
        return feedback.target_kw(state, wanted_kw, net_kw(impp_kw, feedback.grid), late)

    def _of_stores(
        self, turn: Turn, setpoint: Setpoint | None, target_kw: float, reports: list[Report]
    ) -> list[float]:
        """Return what each storage is to give: without a setpoint, what the inverters lack."""
        abilities = self.abilities(turn)
        if setpoint is not None:
            wanted_kw = 0.0 if setpoint.storage_kw is UNSET else setpoint.storage_kw
        else:
            impp_kw = total([report.impp_kw for report in reports])
            wanted_kw = storage_kw(target_kw, impp_kw, impp_kw, together(abilities), False)
        return _parts_kw(wanted_kw, abilities)


class CentralState(MeterState, frozen=True, gc=False):
    """What the central controller remembers besides.

    clamped: How many dispatches were beyond what the plant can give.
    offers: What its offers rest on, see `agents.control.offers`.
    course: What the inverters were asked for, in a plant with storages.
    """

    clamped: int = 0
    offers: tuple[float, ...] = ()
    course: Course = Course((), nan)


class CentralController(Parent):
    """Takes the operator's dispatch and moves power between clusters to meet it."""

    def __init__(
        self,
        tree: ControlTree,
        control: Control,
        feedback: Feedback,
        offers: OfferSettings | None = None,
        pursuit: Pursuit = AT_ONCE,
    ) -> None:
        super().__init__(ROOT, tree, control)
        self._pursuit = pursuit
        self._feedback, self._grid = feedback, feedback.grid
        self._offers = offers
        self._meter = METER.of(ROOT)
        self._stages = (Stage("solve", (*self._inputs, self._meter)),)

    def initial_state(self) -> CentralState:
        first = nothing_metered(self._feedback.law)
        course = Course((nan,) * (self._pursuit.delay + 1), nan)
        if self._offers is None:
            return CentralState(first, course=course)
        offers = tuple(nothing_offered(self._offers).tolist())
        return CentralState(first, offers=offers, course=course)

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        return self._stages

    def step(self, state: CentralState, turn: Turn) -> tuple[CentralState, list[Delivery]]:
        reports = self.reports(turn)
        impp_kw = total([report.impp_kw for report in reports])
        possible_kw = net_kw(impp_kw, self._grid)
        state = self._recall(state, turn.get(self._meter))
        state, offered = self._offer(state, turn, possible_kw)
        able = together(self.abilities(turn)) if self._stores else NO_ABILITY
        with_stores_kw = net_kw(impp_kw + able.discharge_kw, self._grid)
        state = self._feedback.read(state, turn.get(self._meter))
        state, notices = self._follow_dispatch(state, turn)
        outputs = [*self.report_up(turn, reports), *offered, *notices]
        if turn.get(_DISPATCH) is not None and self._control.periods.acts(ROOT, turn.cycle):
            late = min(r.stale_cycles for r in reports) + turn.cycle - state.meter_cycle
            wanted_kw = self._wanted_kw(state, turn, with_stores_kw)
            state, target_kw = self._feedback.target_kw(state, wanted_kw, possible_kw, late)
            if self._stores:
                state, found = self._with_stores(state, turn, target_kw, impp_kw, reports)
                outputs += found
            else:
                outputs += self.setpoints(turn, target_kw, reports)
        outputs.append(self._memory(state, turn, has_offered=bool(offered)))
        return state, outputs

    def _with_stores(
        self,
        state: CentralState,
        turn: Turn,
        target_kw: float,
        impp_kw: float,
        reports: list[Report],
    ) -> tuple[CentralState, list[Delivery]]:
        abilities = self.abilities(turn)
        able, is_first = together(abilities), self._control.storage == "first"
        inverters_kw = asked_kw(target_kw, impp_kw, state.correction.error_kw, able)
        course = next_course(state.course, inverters_kw, impp_kw, self._pursuit)
        power_kw = storage_kw(target_kw, impp_kw, course.coming_kw, able, is_first)
        of_stores = _parts_kw(power_kw, abilities)
        outputs = self.setpoints(turn, inverters_kw, reports, of_stores)
        return replace(state, course=course), outputs

    def _recall(self, state: CentralState, meter: Meter | None) -> CentralState:
        """Go on, in a new process, from what the one before it stated last."""
        if meter is None:
            return state
        state = self._feedback.recalled(state, meter)
        record, own = meter.record, state.offers
        is_record = record is not None and len(record) == len(own) > 0
        if record is not None and is_record and known_intervals(own) < known_intervals(record):
            state = replace(state, offers=record)
        return state

    def _memory(self, state: CentralState, turn: Turn, *, has_offered: bool) -> Delivery:
        memory = self._feedback.memory(state, turn)
        if self._offers is not None:
            memory.intervals = known_intervals(state.offers)
            memory.record = state.offers if has_offered and turn.cycle >= 0 else None
        return MEMORY.of(ROOT), memory

    def _offer(
        self, state: CentralState, turn: Turn, possible_kw: float
    ) -> tuple[CentralState, list[Delivery]]:
        """Remember the cycle, and offer a share of the clear sky if that is due."""
        dispatch, meter, settings = turn.get(_DISPATCH), turn.get(self._meter), self._offers
        if settings is None:
            return state, []
        share = nan
        if turn.cycle < 0:
            share = settings.first_share
        elif dispatch is not None and dispatch.cycle == turn.cycle:
            # The record is of an earlier cycle than the one that the meter shows.
            is_metered = (
                meter is not None and meter.cycle == turn.cycle > 0 and meter.record is None
            )
            values = np.array(state.offers)
            share = observe(
                memory_of(values, settings),
                settings,
                turn.cycle,
                possible_kw,
                meter.power_kw if meter is not None and is_metered else nan,
                dispatch.power_kw,
                dispatch.clear_sky_kw or 0.0,
            )
            state = replace(state, offers=tuple(values.tolist()))
        return state, [] if isnan(share) else [(OFFER.of(ROOT), Offer(*turn.stamp, share=share))]

    def _follow_dispatch(
        self, state: CentralState, turn: Turn
    ) -> tuple[CentralState, list[Delivery]]:
        """Move the reference to the dispatch, and say where that cannot be."""
        dispatch, notices = turn.get(_DISPATCH), list[Delivery]()
        if dispatch is None:
            return state, notices
        usable_kw = usable_dispatch_kw(dispatch.power_kw, dispatch.plant_rating_kw)
        if usable_kw != dispatch.power_kw and dispatch.cycle == turn.cycle:
            # Downward regulation may exceed the commitment, so that the dispatch is below 0.
            what = "0 kW" if usable_kw == 0.0 else f"the rating, {usable_kw:.10g} kW"
            text = f"dispatch of {dispatch.power_kw:.10g} kW clamped to {what}"
            state = replace(state, clamped=state.clamped + 1)
            notices.append((NOTICE.of(ROOT), Notice(*turn.stamp, text=text, count=state.clamped)))
        reference_kw = ramped_kw(state.reference_kw, usable_kw, self._grid)
        return replace(state, reference_kw=reference_kw), notices

    def _wanted_kw(self, state: CentralState, turn: Turn, possible_kw: float) -> float:
        """Return what the plant is to give, with its response to the frequency."""
        meter = turn.get(self._meter)
        frequency_hz = nan if meter is None or meter.frequency_hz is None else meter.frequency_hz
        asked_kw = response_kw(frequency_hz, self._grid)
        return desired_kw(state.reference_kw, asked_kw, possible_kw, self._grid)
