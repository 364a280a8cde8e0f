"""The whole hierarchy and its plant as one compiled loop over the cycles of a run.

It does, number by number, what the agents do between them (`agents.direct`, `agents.supervisor`,
`agents.central`, `sim_plant.plant`) when all messages arrive: a test holds the two equal to 1e-9.
It exists because a study asks for thousands of days, and an agent is a hundred times slower.
Compiled by Numba at its first use; the compiled code is kept for the next.
"""

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from agents.control import forecast
from agents.control.curtailment import ROUNDING
from agents.control.impp import METER_TOLERANCE
from agents.plan import Actuator, RunPlan
from launch_scripts.study.control_arrays import control_arrays
from sim_plant.profile import Profile

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]

PAPER: Final = 0
PREDICTIVE: Final = 1
TOLD: Final = 2


class Estimator(NamedTuple):
    """How the maxima are estimated.

    The compiled loop is given all constants as values: what it took from another module itself
    would stay in the code that Numba keeps on disk when that module changes.

    Attributes
    ----------
    kind
        `PAPER`, `PREDICTIVE`, or `TOLD`: the last cycle's true maximum, that nobody can measure
        behind a limit. It serves to tell what hiding it costs.
    damping, margin, memory_cycles, growth, and those below `held`
        As in `agents.control`; all but the last two for `PREDICTIVE` only.
    held
        Whether an inverter that is asked for all it has is limited to what it is believed to have.
        The agents let it free.
    """

    kind: int
    damping: float = forecast.DAMPING
    margin: float = forecast.MARGIN
    memory_cycles: float = forecast.ERROR_MEMORY_CYCLES
    growth: float = forecast.HIDDEN_GROWTH
    held: bool = False
    bound_tolerance: float = forecast.BOUND_TOLERANCE
    bound_spreads: float = forecast.BOUND_SPREADS
    widest_tolerance: float = forecast.WIDEST_BOUND_TOLERANCE
    meter_memory_cycles: float = forecast.METER_MEMORY_CYCLES
    first_meter_error: float = forecast.FIRST_METER_ERROR
    low_reading: float = forecast.LOW_READING
    low_reading_safety: float = forecast.LOW_READING_SAFETY
    low_reading_memory_cycles: float = forecast.LOW_READING_MEMORY_CYCLES
    release_jump: float = forecast.RELEASE_JUMP
    meter_tolerance: float = METER_TOLERANCE
    rounding: float = ROUNDING


class LoopResult(NamedTuple):
    """What the inverters did and what was believed of them, each of shape (cycles, n)."""

    power_kw: NDArray[np.float64]
    impp_kw: NDArray[np.float64]
    residual_kw: NDArray[np.float64]
    alpha: NDArray[np.float64]


def run_loop(
    plan: RunPlan, profile: Profile, estimator: Estimator, actuator: Actuator
) -> LoopResult:
    """Run a plan's hierarchy on a profile.

    Parameters
    ----------
    plan, profile
        The run. The plan's own scheme and actuator do not count.
    estimator, actuator
        How maxima are estimated, and what inverters do with a command.
    """
    arrays = control_arrays(plan, profile.cycles)
    hides = estimator.kind == PREDICTIVE and actuator == "limit"
    found = _loop(
        profile.mpp_kw,
        profile.commitment_kw + profile.regulation_kw,
        profile.meter_error,
        arrays.rating_kw,
        arrays.parents,
        arrays.children,
        arrays.period,
        arrays.rests & (estimator.kind == PREDICTIVE),
        arrays.order,
        arrays.hour,
        forecast.HIDDEN_ALPHA_MIN if hides else plan.alpha_min,
        actuator == "limit",
        estimator,
    )
    return LoopResult(*found)


@njit(cache=True)
def _loop(
    mpp_kw: Floats,
    dispatch_kw: Floats,
    meter_error: Floats,
    rating_kw: Floats,
    parents: Ints,
    children: Ints,
    period: Ints,
    lends: NDArray[np.bool_],
    order: Ints,
    hour: Ints,
    alpha_min: float,
    limited: bool,
    rule: Estimator,
) -> tuple[Floats, Floats, Floats, Floats]:
    cycles, inverters = mpp_kw.shape
    impp_kw = np.empty((cycles, inverters))
    residual_kw = np.empty((cycles, inverters))
    alpha = np.empty((cycles, inverters))
    power_kw = np.empty((cycles, inverters))
    # What each direct controller remembers: IMPP, age, measured, expected, spread, meter error,
    # how far below its limit it read, how far it may.
    memory = np.zeros((inverters, 8))
    memory[:, 1] = 0.0 if rule.kind == PAPER else 1.0
    memory[:, 5] = rule.first_meter_error
    last_kw = mpp_kw[0].copy()
    level = np.ones(inverters)
    limit_kw = rating_kw[:inverters].copy()
    request_kw = np.zeros(len(rating_kw))
    target_kw = rating_kw.copy()
    node_impp_kw = np.zeros(len(rating_kw))
    for cycle in range(cycles):
        measured_kw = last_kw * (1.0 + meter_error[cycle])
        for i in range(inverters):
            if rule.kind == PAPER:
                _estimate(memory[i], measured_kw[i], level[i], rating_kw[i], rule)
            elif rule.kind == TOLD:
                last_mpp_kw = mpp_kw[max(cycle - 1, 0), i] * (1.0 + meter_error[cycle, i])
                memory[i, 0] = min(last_mpp_kw, rating_kw[i])
            else:
                share = 1.0 if limited else level[i]
                _forecast(memory[i], measured_kw[i], share, limit_kw[i], rating_kw[i], rule)
        node_impp_kw[:inverters] = memory[:, 0]
        _dispatch(dispatch_kw[cycle], parents[0], rating_kw, target_kw)
        _request(cycle, parents, children, period, rating_kw, target_kw, request_kw)
        _report(parents, children, node_impp_kw)
        _solve(
            cycle,
            parents,
            children,
            period,
            lends,
            order[hour[cycle]],
            rating_kw,
            node_impp_kw,
            target_kw,
        )
        impp_kw[cycle] = node_impp_kw[:inverters]
        residual_kw[cycle] = node_impp_kw[:inverters] - request_kw[:inverters]
        for i in range(inverters):
            level[i] = _curtailment(target_kw[i], node_impp_kw[i], alpha_min, rule)
            if limited:
                is_free = level[i] >= 1.0 and not rule.held
                limit_kw[i] = rating_kw[i] if is_free else level[i] * node_impp_kw[i]
            share = 1.0 if limited else level[i]
            last_kw[i] = min(share * mpp_kw[cycle, i], limit_kw[i])
        alpha[cycle] = level
        power_kw[cycle] = last_kw
    return power_kw, impp_kw, residual_kw, alpha


@njit(cache=True)
def _request(
    cycle: int,
    parents: Ints,
    children: Ints,
    period: Ints,
    rating_kw: Floats,
    target_kw: Floats,
    request_kw: Floats,
) -> None:
    """`Family.requests`, from the root down: each parent asks in its turns."""
    if cycle % period[0] == 0:
        request_kw[parents[0]] = target_kw[parents[0]]
    for row in range(len(parents)):
        if cycle % period[row] == 0:
            total_kw = _sum_of_children(row, children, rating_kw)
            for child in children[row]:
                if child >= 0:
                    share = rating_kw[child] / total_kw
                    request_kw[child] = request_kw[parents[row]] * share


@njit(cache=True)
def _report(parents: Ints, children: Ints, impp_kw: Floats) -> None:
    """`Family.report_up`: the sums of the children, from the inverters up."""
    for row in range(len(parents) - 1, -1, -1):
        impp_kw[parents[row]] = _sum_of_children(row, children, impp_kw)


@njit(cache=True)
def _solve(
    cycle: int,
    parents: Ints,
    children: Ints,
    period: Ints,
    lends: NDArray[np.bool_],
    order: Ints,
    rating_kw: Floats,
    impp_kw: Floats,
    target_kw: Floats,
) -> None:
    """`Family.divide`, from the root down: each parent divides its last target in its turns."""
    for row in range(len(parents)):
        if cycle % period[row] == 0:
            _allocate(
                target_kw[parents[row]],
                children[row],
                lends[row],
                rating_kw,
                impp_kw,
                order[row],
                target_kw,
            )


@njit(cache=True)
def _plausible(measured_kw: float, alpha: float, rating_kw: float, rule: Estimator) -> bool:
    return 0.0 <= measured_kw <= rating_kw * (1.0 + rule.meter_tolerance) and 0.0 < alpha <= 1.0


@njit(cache=True)
def _estimate(
    memory: Floats, measured_kw: float, alpha: float, rating_kw: float, rule: Estimator
) -> None:
    """`agents.control.impp.estimate_impp`."""
    if _plausible(measured_kw, alpha, rating_kw, rule):
        memory[0] = min(measured_kw / alpha, rating_kw)


@njit(cache=True)
def _forecast(
    memory: Floats,
    power_kw: float,
    alpha: float,
    limit_kw: float,
    rating_kw: float,
    rule: Estimator,
) -> None:
    """`agents.control.forecast.forecast_impp`."""
    if not _plausible(power_kw, alpha, rating_kw, rule):
        memory[1] += 1.0
        return
    measured_kw = min(power_kw / alpha, rating_kw)
    memory[7] *= 1.0 - 1.0 / rule.low_reading_memory_cycles
    if 0.0 < memory[6] <= rule.low_reading and measured_kw > rule.release_jump * memory[2]:
        memory[7] = max(memory[7], rule.low_reading_safety * memory[6])
    tolerance = max(rule.bound_tolerance, rule.bound_spreads * memory[5], memory[7])
    tolerance = min(tolerance, rule.widest_tolerance)
    memory[6] = 0.0
    if limit_kw < rating_kw and power_kw >= limit_kw * (1.0 - tolerance):
        if limit_kw > 0.0:
            above = max(power_kw / limit_kw - 1.0, 0.0)
            memory[5] += (above - memory[5]) / rule.meter_memory_cycles
        assumed_kw = min(max(memory[2], limit_kw) * (1.0 + rule.growth), rating_kw)
        memory[0] = memory[2] = memory[3] = assumed_kw
        memory[1] += 1.0
        return
    if 0.0 < limit_kw < rating_kw:
        memory[6] = 1.0 - power_kw / limit_kw
    change_kw = 0.0
    if memory[1] == 0.0:
        change_kw = measured_kw - memory[2]
        memory[4] += (abs(measured_kw - memory[3]) - memory[4]) / rule.memory_cycles
    memory[1] = 0.0
    memory[2] = measured_kw
    memory[3] = min(max(measured_kw + rule.damping * change_kw, 0.0), rating_kw)
    memory[0] = max(memory[3] - rule.margin * memory[4], 0.0)


@njit(cache=True)
def _dispatch(asked_kw: float, root: int, rating_kw: Floats, target: Floats) -> None:
    """`CentralController._usable_dispatch`: the root's target is the last dispatch of use."""
    if -np.inf < asked_kw < np.inf:
        target[root] = min(max(asked_kw, 0.0), rating_kw[root])


@njit(cache=True)
def _sum_of_children(row: int, children: Ints, value: Floats) -> float:
    total = 0.0
    for child in children[row]:
        if child >= 0:
            total += value[child]
    return total


@njit(cache=True)
def _allocate(
    target_kw: float,
    children: Ints,
    lends: bool,
    rating_kw: Floats,
    impp_kw: Floats,
    order: Ints,
    setpoint_kw: Floats,
) -> None:
    """`agents.control.allocation.allocate` and `lent_power_kw`."""
    capacity_kw = 0.0
    possible_kw = 0.0
    count = 0
    for child in children:
        if child >= 0:
            capacity_kw += rating_kw[child]
            possible_kw += impp_kw[child]
            count += 1
    headroom_kw = np.empty(count)
    needs_kw = np.zeros(count)
    for place in range(count):
        child = children[place]
        share_kw = target_kw * (rating_kw[child] / capacity_kw)
        headroom_kw[place] = impp_kw[child] - share_kw
        needs_kw[place] = max(-headroom_kw[place], 0.0)
        setpoint_kw[child] = min(share_kw, impp_kw[child])
    if target_kw - possible_kw >= 0.0:
        all_needs_kw = needs_kw.sum()
        lent = (target_kw - possible_kw) / all_needs_kw if lends and all_needs_kw > 0.0 else 0.0
        for place in range(count):
            setpoint_kw[children[place]] = impp_kw[children[place]] + lent * needs_kw[place]
        return
    for needy in range(count):
        missing_kw = needs_kw[needy]
        for donor in order[needy]:
            if missing_kw <= 0.0 or donor < 0:
                break
            given_kw = min(missing_kw, headroom_kw[donor])
            if given_kw > 0.0:
                child = children[donor]
                setpoint_kw[child] = min(setpoint_kw[child] + given_kw, impp_kw[child])
                headroom_kw[donor] -= given_kw
                missing_kw -= given_kw


@njit(cache=True)
def _curtailment(setpoint_kw: float, impp_kw: float, alpha_min: float, rule: Estimator) -> float:
    """`agents.control.curtailment.curtailment_level`."""
    if setpoint_kw >= impp_kw * (1.0 - rule.rounding):
        return 1.0
    return min(max(setpoint_kw / impp_kw, alpha_min), 1.0)
