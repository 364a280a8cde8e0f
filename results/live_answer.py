"""The plant's answer to an order, followed while it comes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import nan
from typing import Final

import numpy as np

from agents.control.grid import response_kw
from agents.plan import RunPlan
from bus_schemas.errors import FailureError
from bus_schemas.tree import ROOT
from recordings.read.series import desired_powers
from results.answers import TOLERANCE_PERCENT, Answer, answer
from sim_plant.order_desk import FromPlant, PlantStatus, Reply
from sim_plant.orders import order_of, target_kw

_REST_S: Final = 10.0
_LONGEST_S: Final = 60.0
"""How long the plant is followed once the dispatch is what was asked for, and the longest time, if
the power does not settle: of simulated time."""


def answer_text(found: Answer) -> str:
    """Say in a line how the plant answered: `2,000 kW reached within 1 % after 3.0 s`."""
    asked = _kw(found.to_kw)
    if found.settling_s is None:
        return f"{asked} not reached within {TOLERANCE_PERCENT:g} %"
    took = f"after {found.ramp_s + found.settling_s:.1f} s"
    ramp = f", {found.ramp_s:.1f} s of them a ramp" if found.ramp_s else ""
    reached = f"{asked} reached within {TOLERANCE_PERCENT:g} % {took}{ramp}"
    return f"{reached}, overshoot {found.overshoot_percent or 0.0:z.1f} %"


class LiveAnswer:
    """Follows the plant from an order on until it has settled.

    reply: What became of the order; None: the plant has not said it yet.
    answer: The plant's answer, once it has settled, or something ended it early.
    """

    def __init__(self, plan: RunPlan) -> None:
        self.reply: Reply | None = None
        self.answer: Answer | None = None
        self._plan = plan
        self._before: PlantStatus | None = None
        self._seen: list[PlantStatus] = []

    @property
    def is_over(self) -> bool:
        return self.answer is not None or (self.reply is not None and not self.reply.is_in_force)

    @property
    def progress(self) -> str:
        """Say how far the plant is: `delivers 1,800 kW of 2,000 kW, 3.0 s after the order`."""
        if not self._seen:
            return ""
        status, after_s = self._seen[-1], len(self._seen) * self._plan.timing.cycle_s
        wanted_kw = target_kw(status.dispatch)
        text = f"delivers {_kw(status.delivered_kw)} of {_kw(wanted_kw)}"
        if not _is_there(status):
            text += f", asked for now: {_kw(status.dispatch.power_kw)}"
        return f"{text}, {after_s:.1f} s after the order"

    def lines(self, heard: Iterable[FromPlant]) -> Iterator[str]:
        """Yield what the plant says as text: its reply, how it settled, empty ones meanwhile."""
        for one in heard:
            yield self._reply(one) if isinstance(one, Reply) else self._follow(one)
            if self.is_over:
                return
        if self.reply is None:
            raise FailureError("order: the run ended before the plant took it")
        yield self._end("; the run is over") if self._seen else "the run is over"

    def _reply(self, reply: Reply) -> str:
        self.reply = reply
        return reply.text

    def _follow(self, status: PlantStatus) -> str:
        if self.reply is None:
            self._before = status
            return ""
        if self._seen and _order(status) != _order(self._seen[0]):
            return self._end("; then another order came, or its time was over")
        self._seen.append(status)
        found = _answer(self._before, self._seen, self._plan)
        there_s = found.duration_s - found.ramp_s if _is_there(status) else 0.0
        if there_s >= (_LONGEST_S if found.settling_s is None else _REST_S):
            return self._end("")
        return ""

    def _end(self, remark: str) -> str:
        self.answer = found = _answer(self._before, self._seen, self._plan)
        if found.settling_s is None:
            remark = _reasons(found, self._seen, self._plan) + remark
        return answer_text(found) + remark


def _answer(before: PlantStatus | None, seen: list[PlantStatus], plan: RunPlan) -> Answer:
    """Return the answer to what the grid leaves of the order: ramp limits, and no response."""
    statuses, after = [before or seen[0], *seen], slice(1, None)
    dispatch_kw, delivered_kw, available_kw, frequency_hz = np.array(
        [
            (one.dispatch.power_kw, one.delivered_kw, one.available_kw, one.frequency_hz or nan)
            for one in statuses
        ]
    ).T
    wanted = desired_powers(plan, dispatch_kw, frequency_hz)
    response_kw = wanted["response_kw"]
    delivered_kw = delivered_kw - response_kw
    return answer(
        (wanted["desired_kw"] - response_kw)[after],
        delivered_kw[after],
        available_kw[after] - plan.grid_law.reserve_kw,
        float(delivered_kw[0]),
        plan.timing.cycle_s,
        plan.tree.rating_kw(ROOT),
        float(dispatch_kw[-1]),
    )


def _reasons(found: Answer, seen: list[PlantStatus], plan: RunPlan) -> str:
    """Say why a power was not reached, as far as the plant's statuses tell."""
    law, frequency_hz = plan.grid_law, seen[-1].frequency_hz
    reasons = []
    if found.unable_percent:
        reasons.append("; the sun gave less")
    if found.ramp_s == found.duration_s and _is_there(seen[-1]):
        up = found.to_kw > found.from_kw
        limit = (law.ramp_up_kw if up else law.ramp_down_kw) * 60.0 / plan.timing.cycle_s
        reasons.append(f"; the grid's ramp limit is {limit:,.0f} kW/min")
    if frequency_hz is not None and response_kw(frequency_hz, law):
        reasons.append(f"; the frequency is {frequency_hz:.3f} Hz")
    return "".join(reasons)


def _kw(value: float) -> str:
    return f"{value:z,.0f} kW"


def _is_there(status: PlantStatus) -> bool:
    """Whether the dispatch is what was asked for, and no step of a ramp to it."""
    return status.dispatch.power_kw == target_kw(status.dispatch)


def _order(status: PlantStatus) -> tuple[object, ...]:
    """Return what tells one order from the next; one that is silent still holds."""
    source, cycle, state = order_of(status.dispatch)
    return source, cycle, state == "over"
