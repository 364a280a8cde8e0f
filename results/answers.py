"""How well a plant answered: to orders, steps of its schedule, AGC signals and the frequency.

A cycle's power holds for the whole cycle, so the shortest time of an answer is one cycle. Cycles in
which the sun gives less than the dispatch say nothing about the plant's control, and do not count.
docs/orders.md has the definitions.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from math import ceil, hypot, inf, log, pi
from typing import Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from agents.control.grid import desired_kw
from agents.plan import RunPlan
from bus_schemas.messages import Dispatch
from bus_schemas.tree import ROOT
from recordings.read.series import RunSeries
from results.regulation import performance_score
from results.tables import Column, Table, attributes, key_column
from scenarios.scenario import AnswerBudgets
from sim_plant.orders import is_ordered, target_kw

TOLERANCE_PERCENT: Final = 1.0
"""Of the plant's rating: within it a power has settled. A step of the schedule is larger."""

BAND_PERCENT: Final = 2.5
LEAST_BAND_PERCENT: Final = 0.5
"""Within this band a step has settled: in % of it, and at least in % of the rating. docs/orders.md
says where it comes from."""

_LEAST: Final = ("score", "response_percent", "damping")
"""Of these more is better."""

_SIGNAL_S: Final = 15.0
_LONGEST_SIGNAL_S: Final = 60.0
_SIGNAL_ORDERS: Final = 10
"""So many orders of one source are one AGC signal, if each comes within 15 s of the one before, or
within the time, up to 60 s, in which its source promised to renew it."""

_OF_STEPS: Final = ("reaction_s", "rise_s", "settling_of_change_s", "damping")

_REST_S: Final = 10.0
"""The error at rest is the mean over this time at the end, if the power had settled before it."""

Values = NDArray[np.float64]


class RegulationScore(msgspec.Struct, frozen=True, kw_only=True):
    """How well the plant followed an AGC signal, as PJM scores a regulation signal.

    orders: How many orders the signal had.
    accuracy, delay, score: None: it was shorter than the score needs.
    """

    orders: int
    accuracy: float | None = None
    delay: float | None = None
    score: float | None = None


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """The plant's answer to an order, or to a step of its schedule. None: the run does not tell.

    asked: Who asked for it: `schedule`, or the source of an order.
    cycle, end_cycle: The first cycle of it, and that of what came next.
    from_kw, to_kw: What the plant gave before, and what it was asked for.
    duration_s: Time until the next one, or the end [s].
    ramp_s: Time that the dispatch took to get there [s]; 0: it was a step.
    reaction_s, rise_s: Of a step: until the power had covered a tenth of it, and from there to nine
        tenths [s].
    settling_of_change_s: Of a step: until the power stayed within its band [s].
    damping: Of a step: damping ratio of the second-order system that overshoots as far; 1: none.
    settling_s: From when the dispatch was there until the power stayed within 1 % [s].
    overshoot_percent: Largest power beyond `to_kw`, in % of the rating; after a step down also the
        largest power that is still above it once the inverters have had their time to follow.
    error_percent: Mean of power less dispatch at rest, in % of the rating. None: it was cut short.
    ramp_deviation_percent: Mean deviation from the ramp, in % of the rating.
    signal: Of an AGC signal: its score.
    response_percent: Of an event of the grid's frequency (asked by `frequency`): the energy of the
        response, in % of what the droop asks for. The figures of a step are those of a step of the
        frequency.
    unable_percent: Share of its cycles in which the sun gave less than the dispatch.
    missed: The figures that did not keep their budgets.
    """

    asked: str
    cycle: int
    end_cycle: int
    from_kw: float
    to_kw: float
    ramp_s: float
    duration_s: float
    reaction_s: float | None = None
    rise_s: float | None = None
    settling_of_change_s: float | None = None
    damping: float | None = None
    settling_s: float | None = None
    overshoot_percent: float | None = None
    error_percent: float | None = None
    ramp_deviation_percent: float | None = None
    signal: RegulationScore | None = None
    response_percent: float | None = None
    unable_percent: float = 0.0
    missed: tuple[str, ...] = ()
    is_judged: bool = False

    @property
    def verdict(self) -> bool | None:
        """Whether all budgets were kept; None: there are none."""
        return not self.missed if self.is_judged else None

    @property
    def score(self) -> float | None:
        return self.signal.score if self.signal else None


class _Asked(NamedTuple):
    """What was asked of the plant: an order, or the schedule (None) as it says.

    signal_s: Time within which a next order of the same source makes it part of an AGC signal [s].
    """

    cycle: int
    by: str = "schedule"
    power_kw: float | None = None
    signal_s: float = 0.0


def answers(series: RunSeries) -> tuple[Answer, ...]:
    """Return the plant's answers in a run, in the order of time."""
    # Frequency response is answered on its own: it ends the answer before it, and what is asked
    # beside it, and what the sun has for that, is what it and its reserve leave.
    dispatch_kw, known = series.desired_kw - series.response_kw, series.known
    delivered_kw = series.delivered_kw - series.response_kw
    available_kw = series.available_kw - series.plan.grid_law.reserve_kw
    rating_kw = series.rating_kw
    found = []
    for group, after in pairwise([*_groups(series, rating_kw), [_Asked(series.cycles)]]):
        asked = group[0]
        responses = np.flatnonzero(series.response_kw[asked.cycle + 1 : after[0].cycle])
        end = asked.cycle + 1 + int(responses[0]) if len(responses) else after[0].cycle
        cycles = slice(asked.cycle, end)
        before_kw = float(delivered_kw[max(asked.cycle - 1, 0)])
        if not known[cycles].all() or not np.isfinite(before_kw):
            continue
        step = answer(
            dispatch_kw[cycles],
            delivered_kw[cycles],
            available_kw[cycles],
            before_kw,
            series.cycle_s,
            rating_kw,
            None if len(group) > 1 else asked.power_kw,
            _follow_s(series.plan, before_kw - float(dispatch_kw[end - 1])),
        )
        step = msgspec.structs.replace(step, asked=asked.by, cycle=asked.cycle, end_cycle=end)
        found.append(_scored(step, series, cycles, len(group)) if len(group) > 1 else step)
    return tuple(sorted([*found, *_to_frequency(series)], key=lambda one: one.cycle))


def answer(
    dispatch_kw: Values,
    delivered_kw: Values,
    available_kw: Values,
    from_kw: float,
    cycle_s: float,
    rating_kw: float,
    to_kw: float | None = None,
    follow_s: float = inf,
) -> Answer:
    """Return the answer to what a dispatch asks for from its first cycle on, shape (T,).

    `to_kw` is where the dispatch was to go, if that is not where it came to. `follow_s` is the time
    that inverters take to follow; infinite: it is not known.
    """
    to_kw = float(dispatch_kw[-1]) if to_kw is None else to_kw
    tolerance_kw = rating_kw * TOLERANCE_PERCENT / 100.0
    # A schedule that follows the sun moves on: a ramp ends where it has come near its end.
    moving = np.flatnonzero(np.abs(dispatch_kw - to_kw) > tolerance_kw)
    there = int(moving[-1]) + 1 if len(moving) else 0
    able = available_kw >= dispatch_kw - tolerance_kw
    error_kw, ahead = delivered_kw - dispatch_kw, float(np.sign(to_kw - from_kw)) or 1.0
    outside = np.flatnonzero((np.abs(error_kw) > tolerance_kw) & able)
    outside = outside[outside >= there]
    settled = int(outside[-1]) + 1 if len(outside) else there
    rest = len(error_kw) - max(round(_REST_S / cycle_s), 1)
    percent = 100.0 / rating_kw
    is_settled = settled < len(error_kw) and bool(able[settled:].any())
    # Before it has rested for that long, the dispatch may still be on its way within 1 %.
    at_rest = error_kw[rest:][able[rest:]] if rest >= settled else error_kw[:0]
    beyond_kw = ahead * error_kw
    if follow_s < inf and ahead < 0.0:  # What stays above the order is too much, too.
        followed = there + ceil(follow_s / cycle_s)
        beyond_kw[followed:] = np.abs(error_kw[followed:])
    beyond = beyond_kw[there:][able[there:]]
    ramp = slice(0, there)
    deviations = np.abs(error_kw[ramp])[able[ramp]]
    found = Answer(
        asked="",
        cycle=0,
        end_cycle=len(dispatch_kw),
        from_kw=from_kw,
        to_kw=to_kw,
        ramp_s=there * cycle_s,
        duration_s=len(dispatch_kw) * cycle_s,
        settling_s=(settled - there + 1) * cycle_s if is_settled else None,
        overshoot_percent=max(float(beyond.max()), 0.0) * percent if len(beyond) else None,
        error_percent=float(at_rest.mean()) * percent if is_settled and len(at_rest) else None,
        ramp_deviation_percent=float(deviations.mean()) * percent if len(deviations) else None,
        unable_percent=100.0 * float((~able).mean()),
    )
    if there:
        return found
    parts = delivered_kw - from_kw, error_kw, to_kw - from_kw, able, rating_kw, cycle_s
    return msgspec.structs.replace(found, **_step_figures(*parts))


def _step_figures(
    covered_kw: Values,
    error_kw: Values,
    change_kw: float,
    able: NDArray[np.bool_],
    rating_kw: float,
    cycle_s: float,
) -> dict[str, float | None]:
    """Return how a step was answered, in the terms of IEEE 2800.

    `covered_kw` is the power less that before the step, `error_kw` the power less what was asked.
    """
    ahead, size_kw = float(np.sign(change_kw)) or 1.0, abs(change_kw)
    began, came = ahead * covered_kw >= 0.1 * size_kw, ahead * covered_kw >= 0.9 * size_kw
    has_begun, has_come = bool(began.any()), bool(came.any())
    band_kw = max(BAND_PERCENT * size_kw, LEAST_BAND_PERCENT * rating_kw) / 100.0
    outside = np.flatnonzero((np.abs(error_kw) > band_kw) & able)
    settled = int(outside[-1]) + 1 if len(outside) else 0
    return {
        "reaction_s": (int(began.argmax()) + 1) * cycle_s if has_begun else None,
        "rise_s": int(came.argmax() - began.argmax()) * cycle_s if has_come else None,
        "settling_of_change_s": (settled + 1) * cycle_s if able[settled:].any() else None,
        "damping": _damping(ahead * error_kw[able], size_kw) if has_come else None,
    }


def _damping(beyond_kw: Values, size_kw: float) -> float | None:
    """Return the damping ratio of the second-order system that goes as far beyond its step.

    Such a system overshoots by the share exp(-pi z / sqrt(1 - z^2)) of a step.
    """
    share = float(beyond_kw.max()) / size_kw if len(beyond_kw) and size_kw else 0.0
    if share <= 0.0:
        return 1.0
    decay = max(-log(share), 0.0)
    return decay / hypot(pi, decay)


def _follow_s(plan: RunPlan, change_kw: float) -> float:
    """Return how long inverters take to follow a change of the plant's power [s]."""
    if plan.site.devices or plan.site.meter:
        return inf
    settings = [plan.site.settings_of(leaf) for leaf in plan.tree.leaves]
    percent = 100.0 * abs(change_kw) / plan.tree.rating_kw(ROOT)
    return max((one.delay_s or 0.0) + percent / (one.ramp_percent_per_s or inf) for one in settings)


def judged(found: tuple[Answer, ...], budgets: AnswerBudgets | None) -> tuple[Answer, ...]:
    """Return answers with what each of them missed of the budgets, if there are any."""
    if budgets is None:
        return found
    return tuple(
        msgspec.structs.replace(one, missed=tuple(_missed(one, budgets)), is_judged=True)
        for one in found
    )


def _missed(found: Answer, budgets: AnswerBudgets) -> Iterator[str]:
    for name, limit in msgspec.structs.asdict(budgets).items():
        value = getattr(found, name)
        if limit is None:
            continue
        if value is None:
            # A power that had the time and did not settle; without the sun it could not.
            of_power = name == "settling_s" and found.asked != "frequency"
            of_step = name == "settling_of_change_s" and not found.ramp_s
            is_judged = (of_power or of_step) and not (found.signal or found.unable_percent)
            if is_judged and found.duration_s - found.ramp_s > limit:
                yield name
        elif (value < limit) if name in _LEAST else (abs(value) > limit):
            yield name


def answers_tables(found: Iterable[Answer]) -> list[Table]:
    """Return the table of a plant's answers; none where nothing was asked."""
    columns = (
        key_column("by", "asked"),
        Column("cycle", name="cycle", key=True),
        Column("from", "kW", 0, name="from_kw"),
        Column("to", "kW", 0, name="to_kw"),
        Column("ramp", "s", 1, name="ramp_s"),
        Column("reaction", "s", 1, name="reaction_s"),
        Column("rise", "s", 1, name="rise_s"),
        Column("into band", "s", 1, name="settling_of_change_s"),
        Column("damping", "", 2, name="damping"),
        Column("settled", "s", 1, name="settling_s"),
        Column("overshoot", "%", 2, name="overshoot_percent"),
        Column("at rest", "%", 2, name="error_percent"),
        Column("off the ramp", "%", 2, name="ramp_deviation_percent"),
        Column("score", "", 3, name="score"),
        Column("response", "%", 1, name="response_percent"),
        Column("budgets", name="verdict"),
    )
    rows = attributes(found, columns)
    notes = (
        "Reaction: to 10 % of a step. Rise: from there to 90 %. Into band: from the step until the "
        f"power stayed within {BAND_PERCENT} % of it, or {LEAST_BAND_PERCENT} % of the rating.",
        "Settled: from when the dispatch was there until the power stayed within 1 % of the "
        "rating. Percentages are of the rating.",
        "Response: to the frequency, its energy in % of what the droop asks for.",
        "Cycles in which the sun gave less than the dispatch do not count.",
    )
    return [Table("How the plant answered", columns, rows, notes)] if rows else []


def _groups(series: RunSeries, rating_kw: float) -> Iterator[list[_Asked]]:
    """Yield what was asked, one by one; all orders of an AGC signal at once."""
    steps_kw = np.abs(np.diff(series.commitment_kw, prepend=series.commitment_kw[:1]))
    steps = np.flatnonzero(steps_kw > rating_kw * TOLERANCE_PERCENT / 100.0).tolist()
    found = {cycle: _Asked(cycle) for cycle in steps if _is_scheduled(series.orders, cycle)}
    for dispatch in series.orders:
        cycle = dispatch.cycle
        if dispatch.order_state == "over":
            found[cycle] = _Asked(cycle)
        elif cycle == dispatch.order_cycle:
            signal_s = min(max(dispatch.order_renew_s or 0.0, _SIGNAL_S), _LONGEST_SIGNAL_S)
            power_kw = None
            if is_ordered(dispatch):
                power_kw = desired_kw(target_kw(dispatch), 0.0, inf, series.plan.grid_law)
            found[cycle] = _Asked(cycle, dispatch.order_source, power_kw, signal_s)
    group: list[_Asked] = []
    for one, after in pairwise([*sorted(found.values()), _Asked(series.cycles)]):
        group.append(one)
        if after.by == one.by and (after.cycle - one.cycle) * series.cycle_s <= one.signal_s:
            continue
        yield from [group] if len(group) >= _SIGNAL_ORDERS else [[single] for single in group]
        group = []


def _is_scheduled(orders: tuple[Dispatch, ...], cycle: int) -> bool:
    """Whether the schedule holds in a cycle."""
    newest = next((one for one in reversed(orders) if one.cycle <= cycle), None)
    return newest is None or not is_ordered(newest)


def _scored(step: Answer, series: RunSeries, cycles: slice, orders: int) -> Answer:
    """Return the answer to an AGC signal: what a single step tells does not apply to it."""
    dispatch_kw = series.desired_kw
    middle_kw = float(dispatch_kw[cycles].max() + dispatch_kw[cycles].min()) / 2.0
    half_kw = max(float(np.ptp(dispatch_kw[cycles])) / 2.0, 1e-9)
    offered = np.zeros(series.cycles, dtype=bool)
    offered[cycles] = True
    score = performance_score(
        (dispatch_kw - middle_kw) / half_kw,
        (series.delivered_kw - middle_kw) / half_kw,
        offered,
        series.times[0],
        series.cycle_s,
    )
    found = score or {}
    nothing = dict.fromkeys((*_OF_STEPS, "settling_s", "overshoot_percent", "error_percent"))
    return msgspec.structs.replace(
        step,
        **nothing,
        ramp_s=0.0,
        signal=RegulationScore(
            orders=orders,
            accuracy=found.get("accuracy"),
            delay=found.get("delay"),
            score=found.get("score"),
        ),
    )


def _to_frequency(series: RunSeries) -> Iterator[Answer]:
    """Yield the answer to each time in which the frequency was outside of the deadband.

    The response is what was delivered beyond what the plant was to give without it.
    """
    rating_kw, law = series.rating_kw, series.plan.grid_law
    tolerance_kw, ideal_kw = rating_kw * TOLERANCE_PERCENT / 100.0, series.response_kw
    reference_kw = series.desired_kw - ideal_kw
    if law.reserve_kw > 0.0:  # What the reserve holds back under clouds is no response.
        reference_kw = np.minimum(reference_kw, series.available_kw - law.reserve_kw)
    given_kw = series.delivered_kw - reference_kw
    able = series.known & (series.available_kw >= series.desired_kw - tolerance_kw)
    edges = np.flatnonzero(np.diff(ideal_kw != 0.0, prepend=False, append=False))
    for cycle, end in edges.reshape(-1, 2).tolist():
        cycles = slice(cycle, end)
        farthest = int(np.abs(ideal_kw[cycles]).argmax())
        most_kw = float(ideal_kw[cycles][farthest])
        if abs(most_kw) <= tolerance_kw:
            continue
        asked_kw, judged = ideal_kw[cycles], able[cycles]
        left = np.abs(asked_kw - most_kw) > tolerance_kw
        held = slice(0, int(left.argmax()) if left.any() else None)
        covered_kw = given_kw[cycles]
        parts = covered_kw[held], (covered_kw - asked_kw)[held], most_kw, judged[held]
        step = {} if farthest else _step_figures(*parts, rating_kw, series.cycle_s)
        asked, given = float(asked_kw[judged].sum()), float(given_kw[cycles][judged].sum())
        found = Answer(
            asked="frequency",
            cycle=cycle,
            end_cycle=end,
            from_kw=float(reference_kw[cycle]),
            to_kw=float(reference_kw[cycle] + most_kw),
            ramp_s=farthest * series.cycle_s,
            duration_s=(end - cycle) * series.cycle_s,
            response_percent=100.0 * given / asked if asked else None,
            unable_percent=100.0 * float((~judged).mean()),
        )
        yield msgspec.structs.replace(found, **step)
