"""What must hold of every decision of a controller, by the messages that it says it used.

Formulas are those of the paper and of docs/grid.md, written again here: nothing is imported from
the control law, so that an error in it cannot hide itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, inf, isnan, nan
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from plant_judges import Breaches, net_kw
from run_trace import EXACT, Decision, FaultyRun, key

from bus_schemas.tree import CENTRAL, ROOT

MOST_CORRECTION: Final = 0.1
"""Of the plant's rating."""

GROWTH_PER_S: Final = 0.01
"""How fast a hidden maximum is taken to grow."""

STEADY_SHARE: Final = 0.002
"""Of the plant's rating: an aim that moves less in a turn is steady."""

MISSED_SHARE: Final = 0.005
"""Of the plant's rating: a steady error above this is corrected."""

MOST_GAIN_PER_S: Final = 0.6
"""Share of an error that is taken for lasting in a second, or at once, at most."""

FEW_TRIED_SHARE: Final = 0.015
"""Of the plant's rating: beyond corrections of so much it counts by how much they have helped."""

LEAST_WAY: Final = 0.001
"""Share of an error by which power that is on its way changes it in a turn, at least."""

CORRECTS_WITHIN_S: Final = 10.0
"""Time in which a steady error changes the correction, besides that of the slowest inverter."""

LEAST_ROOM: Final = 0.005
"""Of its rating: an inverter that is asked for all it has is held so much above it, at least."""


def share_kw(run: FaultyRun, one: Decision, node: str) -> float | None:
    """Return a node's share of the dispatch that was used [kW]."""
    dispatch, plant_kw = one.used["dispatch"], run.rating_kw()
    if dispatch is None:
        return None
    return float(min(max(dispatch.power_kw, 0.0), plant_kw) * run.sharing_kw(node) / plant_kw)


def estimates(run: FaultyRun) -> Breaches:
    """Check that an IMPP follows from what its inverter measured, and says how old that is."""
    control, cycle_s = run.plan.control, run.plan.timing.cycle_s
    known: dict[str, _Known] = {}
    for one in run.of_stage("estimate"):
        leaf, rating_kw = one.node, run.rating_kw(one.node)
        last = known.get(leaf)
        if last is None or last.process != one.process:
            last = known[leaf] = _Known(one.process)
        sent, telemetry = one.sent[key(leaf, "impp")], one.used[key(leaf, "telemetry")]
        fresh = telemetry is not None and telemetry.cycle > last.cycle
        last.stale = 0 if fresh else last.stale + 1
        if one.doubtful:
            continue
        if sent.stale_cycles != last.stale:
            yield one.cycle, f"{leaf} says {sent.stale_cycles} cycles old, not {last.stale}"
        is_lost = last.stale > control.hold_cycles and one.used["dispatch"] is not None
        low_kw = high_kw = 0.0 if is_lost else last.impp_kw
        if fresh:
            low_kw, high_kw = last.bounds_kw(run, telemetry, rating_kw, cycle_s)
        near_kw = EXACT * rating_kw
        if not low_kw - near_kw <= sent.power_kw <= high_kw + near_kw:
            text = f"{leaf} reports {sent.power_kw:,.3f} kW, not {low_kw:,.3f} to {high_kw:,.3f}"
            yield one.cycle, text
        if fresh:
            last.take(telemetry, sent.power_kw)


class _Known:
    """What a process of a direct controller has measured and reported."""

    def __init__(self, process: int) -> None:
        self.process, self.cycle, self.stale, self.impp_kw = process, -1, 0, 0.0
        self.hidden = 0
        self.shown_kw: list[float] = []
        self.impps_kw: list[float] = []

    def take(self, telemetry: Any, impp_kw: float) -> None:
        self.cycle, self.impp_kw = telemetry.cycle, impp_kw
        shown_kw = telemetry.available_kw
        self.shown_kw = [*self.shown_kw, telemetry.power_kw if shown_kw is None else shown_kw][-8:]
        self.impps_kw = [*self.impps_kw, impp_kw][-8:]

    def bounds_kw(
        self, run: FaultyRun, telemetry: Any, rating_kw: float, cycle_s: float
    ) -> tuple[float, float]:
        """Return between which powers the IMPP must be."""
        control, power_kw = run.plan.control, max(telemetry.power_kw, 0.0)
        limit_kw, stated_kw = telemetry.limit_kw, telemetry.available_kw
        if control.scheme == "paper":  # Eq. 1.
            kw = min(power_kw / telemetry.alpha, rating_kw)
            if telemetry.alpha < 1.0 and stated_kw is not None:
                kw = min(max(stated_kw, 0.0), rating_kw)  # One that has tripped draws power.
            return kw, kw
        is_hidden = power_kw >= limit_kw * (1.0 - 1e-9) and limit_kw < self.impp_kw * 0.99
        self.hidden = self.hidden + 1 if is_hidden else 0
        # A forecast goes on with a part of the last changes, and corrects a known meter error.
        shown_kw = power_kw if stated_kw is None else stated_kw
        changes = np.abs(np.diff([*self.shown_kw, shown_kw]))
        band_kw = float(changes.max(initial=0.0)) + 0.04 * power_kw
        if stated_kw is not None:
            return max(min(stated_kw, power_kw) * 0.9 - band_kw, 0.0), min(
                max(stated_kw, power_kw) * 1.1 + band_kw, rating_kw
            )
        if limit_kw >= rating_kw:
            return max(power_kw - band_kw, 0.0), min(power_kw + band_kw, rating_kw)
        # A limit may hide the maximum: what is assumed of it grows slowly.
        most_kw = max(self.impps_kw, default=0.0)
        grown_kw = max(most_kw, limit_kw) * (1.0 + GROWTH_PER_S * cycle_s) ** len(self.impps_kw)
        low_kw = power_kw - band_kw
        if self.hidden > 1:
            growth = GROWTH_PER_S * cycle_s
            low_kw, high_kw = (self.impp_kw * (1.0 + part * growth) for part in (0.5, 1.5))
            return min(low_kw, rating_kw), min(high_kw, rating_kw)
        return max(low_kw, 0.0), min(max(grown_kw, power_kw) * 1.04 + band_kw, rating_kw)


def reports(run: FaultyRun) -> Breaches:
    """Check that IMPP, residual and call for help follow from a share, or from the children."""
    for one in run.of_stage("estimate", "report"):
        own_kw, children = share_kw(run, one, one.node), run.children(one.node)
        if one.doubtful:
            continue
        report = one.sent[key(one.node, "impp")]
        impp_kw, due_kw = report.power_kw, report.power_kw - (own_kw or 0.0)
        left_kw = one.sent[key(one.node, "residual")].power_kw
        if children:
            impp_kw = sum(_counts_kw(run, one, child) for child in children)
            due_kw = sum(_left_kw(run, one, child) for child in children)
            plant = next((its for its in run.plan.plants if its.name == one.node), None)
            if plant is not None:  # It reports what it may feed in.
                impp_kw = max(min(net_kw(run, impp_kw, one.node), plant.export_limit_kw), 0.0)
                due_kw = impp_kw - (own_kw or 0.0)
            age = max(_age(run, one, child) for child in children)
            if report.stale_cycles != age:
                yield one.cycle, f"{one.agent} says {report.stale_cycles} cycles old, not {age}"
        near_kw = EXACT * run.rating_kw(one.node)
        if max(abs(impp_kw - report.power_kw), abs(due_kw - left_kw)) > near_kw:
            text = f"reports {report.power_kw:,.1f} and {left_kw:,.1f} kW"
            yield one.cycle, f"{one.agent} {text}, not {impp_kw:,.1f} and {due_kw:,.1f} kW"
        call = one.sent.get(key(one.node, "help"))
        if (call.missing_kw if call else 0.0) != max(-left_kw, 0.0):
            yield one.cycle, f"{one.agent} calls for help otherwise than its residual says"


def _age(run: FaultyRun, one: Decision, child: str) -> int:
    """Return how many cycles old a child's measurements are; a silent one's have expired."""
    impp = one.used[key(child, "impp")]
    if impp is None:
        return run.plan.control.hold_cycles + 1
    return int(impp.stale_cycles + one.cycle - impp.cycle)


def _counts_kw(run: FaultyRun, one: Decision, child: str) -> float:
    """Return what a parent should count on from a child: its IMPP, or its share if it is silent."""
    impp = one.used[key(child, "impp")]
    return (share_kw(run, one, child) or 0.0) if impp is None else float(impp.power_kw)


def _left_kw(run: FaultyRun, one: Decision, child: str) -> float:
    """Return what a child has beyond its share: its residual, if that is of its IMPP."""
    impp, residual = one.used[key(child, "impp")], one.used[key(child, "residual")]
    if impp is not None and residual is not None and residual.cycle == impp.cycle:
        return float(residual.power_kw)
    return _counts_kw(run, one, child) - (share_kw(run, one, child) or 0.0)


def _divisions(run: FaultyRun) -> Iterator[tuple[Decision, Any, Any, Any, float]]:
    """Yield what each parent gives, what its children have, who is silent, and its target.

    A target that is corrected by a meter is in its shares alone.
    """
    metered = {CENTRAL, *(one.name for one in run.plan.plants)}
    for one in run.of_stage("solve"):
        children = run.children(one.node)
        given = [one.sent.get(key(child, "setpoint")) for child in children]
        if one.doubtful or None in given or one.used["dispatch"] is None:
            continue
        silent = np.array([one.used[key(child, "impp")] is None for child in children])
        has_kw = np.array([_counts_kw(run, one, child) for child in children])
        target_kw = sum(setpoint.share_kw for setpoint in given if setpoint)
        if one.agent not in metered:
            setpoint = one.used[key(one.node, "setpoint")]
            wanted_kw = share_kw(run, one, one.node) if setpoint is None else setpoint.power_kw
            wanted_kw = max((wanted_kw or 0.0) - sum(_of_storages_kw(run, one).values()), 0.0)
            target_kw = max(wanted_kw - has_kw[silent].sum(), 0.0)
        yield one, given, has_kw, silent, target_kw


def division(run: FaultyRun) -> Breaches:
    """Check each child's part: its share by rating, help between siblings, and its setpoint."""
    control = run.plan.control
    for one, given, counted_kw, silent, target_kw in _divisions(run):
        children = run.children(one.node)
        ratings_kw = np.array([run.rating_kw(child) for child in children])
        near_kw, has_kw = EXACT * ratings_kw.sum(), np.where(silent, 0.0, counted_kw)
        shares_kw = np.array([setpoint.share_kw for setpoint in given])
        power_kw = np.array([one.power_kw - (one.storage_kw or 0.0) for one in given])
        # All have the same part of their rating, or what they cannot go below.
        floor_kw = control.alpha_floor * has_kw
        part = (shares_kw / ratings_kw).min()
        due_kw = np.maximum(part * ratings_kw, floor_kw)
        if np.abs(shares_kw - due_kw).max() > near_kw:
            yield one.cycle, f"{one.agent} has unequal shares {shares_kw.round(3).tolist()}"
        most_kw = max(target_kw, floor_kw.sum())
        if not target_kw - near_kw <= shares_kw.sum() <= most_kw + near_kw:
            yield one.cycle, f"{one.agent} shares out {shares_kw.sum():,.3f} of {target_kw:,.3f} kW"
        help_kw = _help_kw(run, one, shares_kw, has_kw)
        got_kw = np.zeros_like(help_kw)
        for donor, setpoint in enumerate(given):
            for line in setpoint.help_given:
                got_kw[donor, children.index(line.needy)] += line.power_kw
        if np.abs(help_kw - got_kw).max() > near_kw:
            at = np.unravel_index(np.abs(help_kw - got_kw).argmax(), help_kw.shape)
            text = f"{got_kw[at]:,.3f} kW, not {help_kw[at]:,.3f} kW"
            yield one.cycle, f"{one.agent}: {children[at[0]]} gives {children[at[1]]} {text}"
        if target_kw >= has_kw.sum():  # All of it, and a part of what lacks.
            due_kw = has_kw.copy()
            if control.scheme == "predictive" and (dark_kw := (ratings_kw - has_kw).sum()) > 0.0:
                due_kw += (target_kw - has_kw.sum()) / dark_kw * (ratings_kw - has_kw)
        else:
            due_kw = np.minimum(shares_kw, has_kw) + help_kw.sum(axis=1)
        due_kw = np.where(silent, counted_kw, due_kw)
        if np.abs(power_kw - due_kw).max() > near_kw:
            n = int(np.abs(power_kw - due_kw).argmax())
            text = f"{power_kw[n]:,.3f} kW, not {due_kw[n]:,.3f} kW"
            yield one.cycle, f"{one.agent} gives {children[n]} {text}"


def _of_storages_kw(run: FaultyRun, one: Decision) -> dict[str, float]:
    """Return what a parent asks of the storages at or below each child that has some [kW]."""
    tree = run.plan.tree
    given = {child: one.sent[key(child, "setpoint")] for child in tree.children(one.node)}
    return {
        child: float(its.power_kw if tree.is_storage(child) else its.storage_kw or 0.0)
        for child, its in given.items()
        if tree.storage_kw(child)
    }


def _able_kw(run: FaultyRun, one: Decision) -> NDArray[np.float64]:
    """Return what the storages of each child can give, take, and be charged with [kW]."""
    children = [one for one in run.plan.tree.children(one.node) if run.plan.tree.storage_kw(one)]
    impps = [one.used[key(child, "impp")] for child in children]
    fields = ("discharge_kw", "absorb_kw", "charge_kw")
    rows = [[getattr(impp, name) or 0.0 if impp else 0.0 for name in fields] for impp in impps]
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _uncharged_kw(run: FaultyRun, one: Decision, asked_kw: float, has_kw: float) -> float:
    """Return the target of which inverters were asked for more, to charge storages [kW].

    They are charged with half of the headroom at most.
    """
    charge_kw = float(_able_kw(run, one)[:, 2].sum())
    return max(asked_kw - charge_kw, 2.0 * asked_kw - has_kw) if asked_kw < has_kw else asked_kw


def storages(run: FaultyRun) -> Breaches:
    """Check what storages are asked for: what inverters lack, or what they give too much.

    The inverters of the campaign's plant with storages follow at once.
    """
    yield from _wrong_abilities(run)
    for one, given, has_kw, silent, _ in _divisions(run):
        parts_kw, able_kw = _of_storages_kw(run, one), _able_kw(run, one)
        setpoint = one.used.get(key(one.node, "setpoint"))
        if not parts_kw:
            continue
        wanted_kw = sum(parts_kw.values())  # Those of a silent child are asked for nothing.
        if setpoint is not None:
            wanted_kw = setpoint.storage_kw or 0.0
        elif one.agent == CENTRAL and not silent.any():
            asked_kw = sum(its.share_kw for its in given)
            least_kw = _uncharged_kw(run, one, asked_kw, has_kw.sum())
            least_kw -= min(asked_kw, has_kw.sum())
            most = max(asked_kw - has_kw.sum(), 0.0)
            wanted_kw = min(max(wanted_kw, least_kw), most)  # Under a sure sky least.
        most_kw = able_kw[:, 0 if wanted_kw >= 0.0 else 1]
        share = min(abs(wanted_kw) / most_kw.sum(), 1.0) if most_kw.sum() else 0.0
        due_kw = np.copysign(share * most_kw, wanted_kw)
        if np.abs(due_kw - [*parts_kw.values()]).max() > 2.0 * EXACT * run.rating_kw():
            yield one.cycle, f"{one.agent} asks storages for {parts_kw}, not {due_kw.tolist()}"


def _wrong_abilities(run: FaultyRun) -> Breaches:
    """Check what storages say that they can give and take, by what they have measured."""
    settings, cycle_s = {one.path: one for one in run.plan.storages}, run.plan.timing.cycle_s
    for one in run.decisions:
        measured, its = one.used.get(key(one.node, "telemetry")), settings.get(one.node)
        if its is None or measured is None or one.doubtful or measured.cycle < one.cycle:
            continue
        said = one.sent[key(one.node, "impp")]
        if not isinstance(measured.energy_kwh, float):  # It is off: its energy is unknown.
            if said.discharge_kw or said.absorb_kw:
                yield one.cycle, f"{one.agent} says that it can give and take, though it is off"
            continue
        kwh, ramp_kw = measured.energy_kwh, its.rating_kw * (its.ramp_percent_per_s or inf) / 100.0
        stored_kwh = kwh - its.lowest_state * its.capacity_kwh
        room_kwh = its.highest_state * its.capacity_kwh - kwh
        give_kw = stored_kwh * its.discharge_efficiency / cycle_s * 3600.0
        take_kw = room_kwh / its.charge_efficiency / cycle_s * 3600.0
        due_kw = (
            max(min(its.rating_kw, give_kw, ramp_kw * cycle_s + measured.power_kw), 0.0),
            max(min(its.rating_kw, take_kw, ramp_kw * cycle_s - measured.power_kw), 0.0),
        )
        if np.abs(np.subtract(due_kw, (said.discharge_kw, said.absorb_kw))).max() > 1e-6:
            yield one.cycle, f"{one.agent} can give and take {due_kw} kW, and says otherwise"


def _help_kw(
    run: FaultyRun, one: Decision, shares_kw: NDArray[np.float64], has_kw: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return who should help whom [kW], shape (donors, needy): the least correlated one first."""
    count, now_ns = len(shares_kw), next(iter(one.sent.values())).sim_time_ns
    hours = run.plan.control.neighbourhoods_of(one.node)
    begun = [hour for hour in hours if hour.from_time_ns <= now_ns] or [*hours[:1]]
    alike = np.array(begun[-1].correlation) if begun else np.zeros((count, count))
    lacks_kw, left_kw = np.maximum(shares_kw - has_kw, 0.0), np.maximum(has_kw - shares_kw, 0.0)
    help_kw = np.zeros((count, count))
    for needy in range(count):
        others = np.argsort(alike[needy], kind="stable").tolist()
        for donor in others:
            if donor != needy:
                help_kw[donor, needy] = min(lacks_kw[needy], left_kw[donor])
                lacks_kw[needy] -= help_kw[donor, needy]
                left_kw[donor] -= help_kw[donor, needy]
    return help_kw


def commands(run: FaultyRun) -> Breaches:
    """Check that an inverter is commanded its setpoint, its share without one, and its revert.

    It is commanded nothing before it has been measured.
    """
    measured: set[tuple[str, int]] = set()
    errors_kw: dict[tuple[str, int], float] = {}
    last: dict[tuple[str, int], Decision] = {}
    for one in run.of_stage("estimate", "actuate"):
        process = one.node, one.process
        if one.stage == "estimate":
            telemetry = one.used[key(one.node, "telemetry")]
            if telemetry is not None:
                measured.add(process)
                before = last.get(process)
                impp_kw = before.sent[key(one.node, "impp")].power_kw if before else 0.0
                apart_kw = abs(telemetry.power_kw - impp_kw)
                errors_kw[process] = max(errors_kw.get(process, 0.0), apart_kw)
            last[process] = one
            continue
        if process not in measured:
            yield one.cycle, f"{one.agent} is commanded before it has been measured"
        elif not one.doubtful and one.reported:
            for text in _wrong_command(run, one, errors_kw[process]):
                yield one.cycle, f"{one.agent} is commanded {text}"


def _wrong_command(run: FaultyRun, one: Decision, error_kw: float) -> Iterator[str]:
    leaf, control, rating_kw = one.node, run.plan.control, run.rating_kw(one.node)
    command, report = one.sent[key(leaf, "command")], one.reported[key(leaf, "impp")]
    setpoint, own_kw, near_kw = (
        one.used[key(leaf, "setpoint")],
        share_kw(run, one, leaf),
        EXACT * rating_kw,
    )
    reverts_kw, impp_kw = command.revert_kw, report.power_kw
    if (reverts_kw is None) != (own_kw is None) or abs((reverts_kw or 0) - (own_kw or 0)) > near_kw:
        yield f"to revert to {reverts_kw}, not {own_kw}"
    target_kw = own_kw if setpoint is None else setpoint.power_kw
    if target_kw is None:
        yield "without a setpoint and a share"
        return
    alpha, low_kw, high_kw = 1.0, rating_kw, rating_kw
    if report.stale_cycles > control.hold_cycles and own_kw is not None:
        # One that is not heard is commanded its share, so that it shows itself if it lives.
        alpha, low_kw, high_kw = command.alpha, own_kw, own_kw
    elif target_kw < impp_kw * (1.0 - 1e-9):
        alpha = min(max(target_kw / impp_kw, control.alpha_floor), 1.0)
        low_kw = high_kw = alpha * impp_kw
    elif control.holds_limits and target_kw <= impp_kw * (1.0 + 1e-9):
        low_kw = min(impp_kw, rating_kw)  # It is held near its forecast.
        high_kw = min(impp_kw + error_kw + 1.01 * LEAST_ROOM * rating_kw, rating_kw)
        if run.plan.site.available_bias is None:
            low_kw = min(impp_kw + 0.99 * LEAST_ROOM * rating_kw, rating_kw)
    if not low_kw - near_kw <= command.power_kw <= high_kw + near_kw:
        yield f"{command.power_kw:,.3f} kW, not {low_kw:,.3f} to {high_kw:,.3f} kW"
    if abs(command.alpha - alpha) > EXACT:
        yield f"alpha {command.alpha:.6f}, not {alpha:.6f}"


class _Aim(NamedTuple):
    """What the central controller aims at in a turn, and by what it corrects [kW].

    low_kw, high_kw: Its target less what its aim needs: the correction, if all of it or none of
        what storages can be charged with is in its target.
    aim_kw: What it should aim at, at the meter.
    possible_kw: What all inverters can give, at the meter.
    readings_kw: What the meter sent since its last turn, up to the newest that was used.
    is_shown: Whether the target shows the correction: it does not at its bounds.
    memory: What it states that a new process will need.
    """

    one: Decision
    low_kw: float
    high_kw: float
    aim_kw: float
    possible_kw: float
    readings_kw: tuple[float, ...]
    is_shown: bool
    memory: Any

    @property
    def lacks_kw(self) -> float:
        return self.aim_kw - float(np.mean(self.readings_kw))


def _aims(run: FaultyRun) -> Iterator[_Aim | None]:
    """Yield what the central controller aims at, turn by turn; None where it is not known."""
    children, near_kw = run.children(ROOT), 2.0 * EXACT * run.rating_kw()
    reference, read, process, own_read, seen_kw = nan, 0, -1, 0, tuple[float, ...]()
    readings = run.trace.of["meter"]
    for one in run.of_stage("solve"):
        if one.agent != CENTRAL:
            continue
        if one.process != process:
            process, reference, own_read, seen_kw = one.process, nan, 0, ()
        meter = one.used["meter"]
        if meter is not None:
            if own_read == 0 and meter.correction_kw is not None:  # It goes on from there.
                reference = nan if meter.reference_kw is None else meter.reference_kw
            own_read = max(own_read, meter.cycle)
            new = range(read + 1, meter.cycle + 1)
            seen_kw += tuple(readings[k][0].power_kw for k in new if k in readings)
            read = max(read, meter.cycle)
        if one.used["dispatch"] is not None:
            reference = reference_kw(run, one, reference)
        given = [one.sent.get(key(child, "setpoint")) for child in children]
        if one.used["dispatch"] is None or one.doubtful or None in given:
            yield None
            continue
        has_kw = {child: _counts_kw(run, one, child) for child in children}
        silent_kw = sum(kw for child, kw in has_kw.items() if one.used[key(child, "impp")] is None)
        target_kw = sum(setpoint.share_kw for setpoint in given if setpoint) + silent_kw
        possible_kw = sum(has_kw.values())
        least_kw = _uncharged_kw(run, one, target_kw, possible_kw)
        wanted_kw = aim_kw(run, one, reference, possible_kw)
        needs_kw = gross_kw(run, wanted_kw)
        stated = run.trace.of["memory"].get(one.cycle, ())
        memory = next((m for m in stated if m.incarnation == one.process), None)
        is_shown = silent_kw + near_kw < target_kw < run.rating_kw() - near_kw
        yield _Aim(
            *(one, least_kw - needs_kw, target_kw - needs_kw, wanted_kw),
            *(net_kw(run, possible_kw), seen_kw, is_shown, memory),
        )
        seen_kw = ()


def target(run: FaultyRun) -> Breaches:
    """Check what the central controller aims at: the dispatch in the grid's limits, corrected."""
    near_kw, watch = 2.0 * EXACT * run.rating_kw(), _Corrections(run)
    control = run.plan.control
    most_kw = near_kw + (MOST_CORRECTION * run.rating_kw() if control.correction else 0.0)
    for now in _aims(run):
        if now is None:
            watch.forget()
        elif now.is_shown and (now.low_kw > most_kw or now.high_kw < -most_kw):
            yield now.one.cycle, f"central corrects by {now.low_kw:,.3f} kW"
        elif control.correction and not control.offset_errors and (text := watch.wrong(now)):
            yield now.one.cycle, f"central {text}"


class _Corrections:
    """Follows the correction from turn to turn.

    Only a reading of the meter that shows an error changes it, soon if a steady aim is missed, and
    not by far more than what lacks. It is 0 while nothing is curtailed. A new process goes on.
    """

    def __init__(self, run: FaultyRun) -> None:
        site, leaves, control = run.plan.site, run.plan.tree.leaves, run.plan.control
        settings = [*map(site.settings_of, leaves)]
        self._rating_kw, self._offset_kw = run.rating_kw(), control.offset_kw
        self._near_kw = 2.0 * EXACT * self._rating_kw
        self._period = control.period_cycles[0]
        self._turn_s = self._period * run.plan.timing.cycle_s
        slowest_s = max(map(site.follows_within_s, leaves))
        self._settles_s = slowest_s + CORRECTS_WITHIN_S + 2.0 * self._turn_s
        self._is_ramped = any(one.ramp_percent_per_s for one in settings)
        delay_s = max(one.delay_s or 0.0 for one in settings)
        self._seen_turns = 2 + ceil(round(delay_s / self._turn_s, 9))
        self._last: _Aim | None = None  # The last turn, if it showed what it corrected by.
        self._turns: list[_Aim] = []  # The last ones of this process, as many as a meter may show.
        self._metered_kw = nan
        self._aims_kw: list[float] = []  # Since they have been steady.
        self._idle = 0
        self._process = -1

    def forget(self) -> None:
        """Go on after a turn of which nothing is known."""
        self._last, self._turns, self._metered_kw = None, [], nan
        self._aims_kw, self._idle = [], 0

    def wrong(self, now: _Aim) -> str:
        """Say what is wrong with the correction of a turn; nothing if it is right."""
        if now.high_kw - now.low_kw > self._near_kw:
            self.forget()
            return ""
        last, is_new = self._last, now.one.process != self._process
        if is_new:
            self.forget()
        text = ""
        if last is not None and now.is_shown and now.memory is not None:
            text = self._begins_wrong(now) if is_new else self._wrong_change(last, now)
        if not text and now.memory is not None:
            text = self._wrong_memory(now)
        self._last, self._process = now if now.is_shown else None, now.one.process
        self._turns = [*self._turns, now][-self._seen_turns :]
        if now.readings_kw:
            self._metered_kw = self._read_kw(now)
        return text

    def _read_kw(self, now: _Aim) -> float:
        """Return what the law read since its last turn; NaN where it may have missed a reading."""
        readings_kw = now.readings_kw
        if self._period == 1:
            return readings_kw[-1]
        return float(np.mean(readings_kw)) if len(readings_kw) == self._period else nan

    def _begins_wrong(self, now: _Aim) -> str:
        """Check that a new process goes on from what the plant repeats to it."""
        meter, kw = now.one.used["meter"], now.memory.lacking_kw
        knows = meter is not None and meter.correction_kw is not None
        before_kw, corrects_kw = (meter.lacking_kw, meter.correction_kw) if knows else (0.0, 0.0)
        aims_kw = [one for one in (meter.expected_kw if knows else ()) if one is not None]
        apart = (abs(aim_kw - read_kw) for aim_kw in aims_kw for read_kw in now.readings_kw)
        most_kw = max(apart, default=0.0) + abs(corrects_kw - before_kw)
        if kw != 0.0 and abs(kw - before_kw) > MOST_GAIN_PER_S * most_kw + self._near_kw:
            return f"begins with {kw:,.3f} kW, not {before_kw:,.3f} kW"
        if kw == 0.0 and abs(before_kw) > self._near_kw and now.aim_kw < now.possible_kw:
            return f"begins anew, not with {before_kw:,.3f} kW"
        return ""

    def _wrong_change(self, last: _Aim, now: _Aim) -> str:
        step_kw = now.low_kw - last.low_kw
        is_steady = abs(now.aim_kw - last.aim_kw) < STEADY_SHARE * self._rating_kw
        self._aims_kw = [*self._aims_kw, now.aim_kw] if is_steady else []
        if now.aim_kw > now.possible_kw + self._near_kw:
            has_all = not any(message.missing for message in now.one.sent.values())
            if abs(now.low_kw) > self._near_kw and has_all:
                return f"corrects by {now.low_kw:,.3f} kW, though nothing is curtailed"
            return ""
        if abs(step_kw) > self._near_kw and (why := self._no_error(now)):
            return f"corrects by {step_kw:,.3f} kW {why}"
        return self._wrong_step(now, step_kw) if now.readings_kw else ""

    def _no_error(self, now: _Aim) -> str:
        """Say why what the meter shows is no error; nothing if it may be one."""
        if not now.readings_kw:
            return "without a reading"
        read_kw = self._read_kw(now)
        if len(self._turns) < self._seen_turns or isnan(read_kw):
            return ""
        could = (
            one.aim_kw - self._offset_kw < one.possible_kw + self._near_kw
            for one in (*self._turns, now)
        )
        if not all(could):
            return "for what only the sky could have given"
        aims_kw = [one.aim_kw for one in self._turns]
        if min(aims_kw) <= read_kw <= max(aims_kw):
            return f"though {read_kw:,.3f} kW was aimed at"
        # Power that only moves as its aims do comes no nearer to them.
        way_kw, aims_way_kw = read_kw - self._metered_kw, float(np.abs(np.diff(aims_kw)).max())
        left_kw = self._turns[-1].aim_kw - read_kw
        is_nearing = abs(way_kw) > 2.0 * aims_way_kw + LEAST_WAY * abs(left_kw)
        if self._is_ramped and way_kw * left_kw > 0.0 and is_nearing:
            return f"while the power goes its way of {way_kw:,.3f} kW"
        return ""

    def _wrong_step(self, now: _Aim, step_kw: float) -> str:
        lacks_kw = now.lacks_kw
        is_bound = abs(now.low_kw + step_kw) > 0.99 * MOST_CORRECTION * self._rating_kw
        is_idle = abs(lacks_kw) > MISSED_SHARE * self._rating_kw and not is_bound
        is_idle = is_idle and step_kw * lacks_kw <= 0.0 and bool(self._aims_kw)
        is_idle = is_idle and now.possible_kw > 1.05 * now.aim_kw
        # Where corrections have only done harm so far, it learns slowly that an error lasts.
        is_idle = is_idle and (now.memory is None or now.memory.helped_share > 0.0)
        self._idle = self._idle + 1 if is_idle else 0
        if self._idle * self._turn_s > self._settles_s:
            return f"does not correct {lacks_kw:,.1f} kW"
        return ""

    def _wrong_memory(self, now: _Aim) -> str:
        """Check what would be missing, as it is stated, and how much of it is corrected."""
        said, rating_kw, near_kw = now.memory, self._rating_kw, self._near_kw
        lacking_kw, correction_kw = said.lacking_kw, said.correction_kw
        if abs(lacking_kw) > MOST_CORRECTION * rating_kw + near_kw:
            return f"takes {lacking_kw:,.3f} kW for missing"
        if now.is_shown and not abs(correction_kw - now.low_kw) <= near_kw:
            return f"says that it corrects by {correction_kw:,.3f} kW, not {now.low_kw:,.3f} kW"
        least = max(said.helped_share, 0.0)
        trust = min((FEW_TRIED_SHARE * rating_kw / max(said.tried_kw, near_kw)) ** 2, 1.0)
        most = min(least + (1.0 - said.helped_share) * trust, 1.0)
        parts_kw = sorted((least * lacking_kw, most * lacking_kw))
        if not parts_kw[0] - near_kw <= correction_kw <= parts_kw[1] + near_kw:
            return f"corrects {correction_kw:,.3f} of {lacking_kw:,.3f} kW, not {least:.3f}"
        before = self._turns[-1].memory if len(self._turns) == self._seen_turns else None
        if before is None or not now.readings_kw or lacking_kw == 0.0:
            return ""
        apart = (abs(one.aim_kw - kw) for one in self._turns for kw in now.readings_kw)
        apart_kw = max(apart) + abs(before.correction_kw - before.lacking_kw)
        most_kw = MOST_GAIN_PER_S * min(self._turn_s, 1.0) * apart_kw + near_kw
        if abs(lacking_kw - before.lacking_kw) > most_kw:
            return f"learns {lacking_kw - before.lacking_kw:,.3f} kW of {apart_kw:,.3f} kW at once"
        return ""


def reference_kw(run: FaultyRun, one: Decision, last_kw: float) -> float:
    """Return the dispatch as far as the grid's ramps let it go in a cycle [kW]."""
    grid, minutes = run.plan.grid, run.plan.timing.cycle_s / 60.0
    dispatch_kw = min(max(one.used["dispatch"].power_kw, 0.0), run.rating_kw())
    if isnan(last_kw):
        return float(dispatch_kw)
    up_kw = (grid.ramp_up_kw_per_min or inf) * minutes
    down_kw = (grid.ramp_down_kw_per_min or inf) * minutes
    return float(min(max(dispatch_kw, last_kw - down_kw), last_kw + up_kw))


def aim_kw(run: FaultyRun, one: Decision, reference_kw: float, has_kw: float) -> float:
    """Return what the plant is to give, with its response to the frequency and its limits [kW]."""
    grid, rating_kw, meter = run.plan.grid, run.rating_kw(), one.used["meter"]
    response_kw = 0.0
    if grid.droop is not None:
        droop, reserve_kw = grid.droop, grid.droop.reserve_percent / 100.0 * rating_kw
        if reserve_kw:
            most_kw = min(net_kw(run, has_kw), grid.pmax * rating_kw) - reserve_kw
            reference_kw = min(reference_kw, max(most_kw, 0.0))
        if meter is not None and meter.frequency_hz is not None:
            error = (grid.nominal_hz - meter.frequency_hz) / grid.nominal_hz
            if error > droop.fdbd2:
                response_kw = min(droop.dup * (error - droop.fdbd2) * rating_kw, reserve_kw)
            elif error < droop.fdbd1:
                response_kw = droop.ddn * (error - droop.fdbd1) * rating_kw
    limited_kw = min(max(reference_kw + response_kw, grid.pmin * rating_kw), grid.pmax * rating_kw)
    return limited_kw + run.plan.control.offset_kw


def gross_kw(run: FaultyRun, aim_kw: float) -> float:
    """Return what inverters must give for a power at the meter, if losses are made up for [kW]."""
    grid, rating_kw = run.plan.grid, run.rating_kw()
    if not run.plan.control.correction:
        return aim_kw
    aim_kw += grid.loss_constant_percent / 100.0 * rating_kw
    square = grid.loss_quadratic_percent / 100.0 / rating_kw
    # Of a x^2 - x + aim = 0 the lower root.
    return aim_kw if square == 0.0 else float(np.roots([square, -1.0, aim_kw]).real.min())


def offers(run: FaultyRun) -> Breaches:
    """Check that an offer comes when it is due, and promises a share that can be."""
    law, cycle_s = run.plan.control.offers, run.plan.timing.cycle_s
    if law is None:
        return
    length = round(law.interval_s / cycle_s)
    lead = round(min(60.0, law.interval_s) if law.lead_s is None else law.lead_s) / cycle_s
    sent = run.trace.of.get("offer", {})
    for one in run.of_stage("solve"):
        dispatch = one.used["dispatch"] if one.agent == CENTRAL else None
        if dispatch is None or dispatch.cycle != one.cycle:
            continue
        is_due = (one.cycle + max(round(lead), 1)) % length == 0
        offer = one.sent.get("offer")
        if is_due != (offer is not None):
            yield one.cycle, "an offer that is not due" if offer else "no offer, though one is due"
        if offer is not None and not 0.0 <= offer.share <= 1.2:
            yield one.cycle, f"a share of {offer.share:.3f} is offered"
    for cycle in sent:
        if (cycle + max(round(lead), 1)) % length:
            yield cycle, "an offer that is not due"
