"""What must hold of the plant in every cycle: its schedule, its inverters, its meters.

Worked out from the documents alone (orders.md, grid.md, scenarios.md); nothing of the plant's own
code is used. The maxima of the inverters are the run's sky, which is given.
"""

from __future__ import annotations

from collections.abc import Iterator
from fnmatch import fnmatchcase
from math import ceil, inf, isnan, nan
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from run_trace import EXACT, FaultyRun, key

from agents.faults import Trip
from agents.plan_parts import PlannedOrder

OVER_LIMIT: Final = 1.02
OVER_FOR: Final = 2
"""By how much, and for how many cycles, a plant of a fleet may be above its export limit."""

Breaches = Iterator[tuple[int, str]]


def whole_cycles(time_s: float, cycle_s: float) -> int:
    return ceil(round(time_s / cycle_s, 9))


def schedule(run: FaultyRun) -> Breaches:
    """Check that the dispatch is what the schedule, an accepted offer, or an order asks for."""
    plan, profile, cycle_s = run.plan, run.profile, run.plan.timing.cycle_s
    law, rating_kw = plan.control.offers, run.rating_kw()
    orders = {int(one.at / cycle_s + 1e-9): one for one in plan.orders}
    offers = _offers(run)
    share, coming = (law.first_share, law.first_share) if law else (0.0, 0.0)
    order: PlannedOrder | None = None
    since, last_kw, on_schedule, interval, before = 0, nan, True, 0, -1
    for cycle in run.trace.cycles.tolist():
        sent = run.trace.of["dispatch"][cycle][0]
        wanted_kw = profile.commitment_kw[cycle] + profile.regulation_kw[cycle]
        if law:
            length = round(law.interval_s / cycle_s)
            if cycle // length != interval:
                interval, share = cycle // length, coming
            wanted_kw = share * profile.clear_sky_kw[cycle] + profile.regulation_kw[cycle]
        passed = range(before + 1, cycle + 1)
        new = [of for of in passed if of in orders]
        if new:
            order, since = orders[new[-1]], cycle
        is_over = order and order.hold_s and (cycle - since) * cycle_s >= order.hold_s
        ordered_kw = None if order is None or is_over else order.power_kw
        holds = ordered_kw is not None
        aim_kw = wanted_kw if ordered_kw is None else min(ordered_kw, rating_kw)
        now_kw = aim_kw
        if order and order.ramp_kw_per_min and not isnan(last_kw) and (holds or not on_schedule):
            step_kw = order.ramp_kw_per_min / 60.0 * cycle_s * len(passed)
            now_kw = min(max(aim_kw, last_kw - step_kw), last_kw + step_kw)
        if abs(sent.power_kw - now_kw) > EXACT * rating_kw:
            yield cycle, f"dispatch {sent.power_kw:,.3f} kW, not {now_kw:,.3f} kW"
        on_schedule, last_kw, before = not holds and now_kw == aim_kw, now_kw, cycle
        coming = offers.get(cycle, coming)


def _offers(run: FaultyRun) -> dict[int, float]:
    """Return the share of each offer that reached the plant in its cycle."""
    missing = {one.cycle: one.missing for one in run.trace.produced}
    return {
        cycle: offer.share
        for cycle, (offer, *_) in run.trace.of.get("offer", {}).items()
        if cycle in missing and not any(one.startswith("offer") for one in missing[cycle])
    }


def net_kw(run: FaultyRun, power_kw: Any, plant: str = "") -> Any:
    """Return what is left of a power at the meter, of all or of a plant of a fleet [kW]."""
    grids = {"": run.plan.grid, **{one.name: one.grid for one in run.plan.plants}}
    grid, rating_kw = grids[plant], run.inverters_kw(plant)
    constant, square = grid.loss_constant_percent / 100.0, grid.loss_quadratic_percent / 100.0
    return power_kw - (constant * rating_kw + square * power_kw**2 / rating_kw)


def fed_in_kw(run: FaultyRun, power_kw: Any, stored_kw: float = 0.0, most: float = inf) -> Any:
    """Return what is fed in of the powers of all inverters: a fleet's plants each lose their own.

    Of a plant no more than `most` of its export limit counts. Fleets of the campaign have no
    storages.
    """
    if not run.plan.plants:
        return net_kw(run, power_kw.sum(axis=-1) + stored_kw)
    return sum(
        np.minimum(plant_kw(run, power_kw, one.name), most * one.export_limit_kw)
        for one in run.plan.plants
    )


def plant_kw(run: FaultyRun, power_kw: Any, plant: str) -> Any:
    """Return what a plant of a fleet feeds in."""
    return net_kw(run, power_kw[..., run.columns(plant)].sum(axis=-1), plant)


def true_mpp_kw(run: FaultyRun, cycle: int) -> NDArray[np.float64]:
    """Return what each inverter can give in a cycle; a tripped one draws standby power [kW]."""
    time_s, leaves = cycle * run.plan.timing.cycle_s, run.plan.tree.leaves
    tripped = [_is_tripped(run, leaf, time_s) for leaf in leaves]
    ratings_kw = np.array([run.rating_kw(leaf) for leaf in leaves])
    return np.where(tripped, -0.001 * ratings_kw, run.profile.mpp_kw[cycle])


def inverters(run: FaultyRun) -> Breaches:
    """Check that inverters obey their newest commands by delay, ramp and revert time.

    The ramp is one of seconds, also through cycles that the plant was too late for.
    """
    plan, cycle_s = run.plan, run.plan.timing.cycle_s
    leaves, count = plan.tree.leaves, len(plan.tree.leaves)
    ratings_kw = np.array([run.rating_kw(leaf) for leaf in leaves])
    settings, reverts = [*map(plan.site.settings_of, leaves)], [*map(plan.site.revert_of, leaves)]
    ramp_percent = np.array([one.ramp_percent_per_s or inf for one in settings])
    delay = np.array([whole_cycles(one.delay_s or 0.0, cycle_s) for one in settings])
    to = [one.to for one in reverts]
    after = np.array([whole_cycles(one.after_s, cycle_s) for one in reverts])
    first_kw = run.profile.commitment_kw[0] + run.profile.regulation_kw[0]
    sharing_kw = np.array([run.sharing_kw(leaf) for leaf in leaves])
    share_kw = sharing_kw * (min(max(first_kw, 0.0), sharing_kw.sum()) / sharing_kw.sum())
    reverts_kw = ratings_kw * [1.0 if isinstance(one, str) else one for one in to]
    # When the run begins an inverter holds its share of the first dispatch.
    power_kw, renewed = run.profile.mpp_kw[0], np.zeros(count)
    alpha = np.where(power_kw > share_kw, share_kw / power_kw, 1.0)
    limit_kw = share_kw if plan.control.actuator == "limit" else ratings_kw
    ordered = [(-(10**9), alpha.copy(), limit_kw.copy())]
    unsure, before = np.zeros(count, dtype=bool), -1
    for one in run.applied:
        cycle, passed = one.cycle, one.cycle - before
        now_alpha, now_kw = ordered[-1][1].copy(), ordered[-1][2].copy()
        for n, leaf in enumerate(leaves):
            command = one.used[key(leaf, "command")]
            unsure[n] |= key(leaf, "command") in one.doubtful
            if command is not None and command.cycle >= renewed[n]:
                renewed[n], now_alpha[n] = command.cycle, command.alpha
                limits = plan.control.actuator == "limit"
                now_kw[n] = min(command.power_kw if limits else inf, ratings_kw[n])
                if to[n] == "share" and command.revert_kw is not None:
                    reverts_kw[n] = min(command.revert_kw, ratings_kw[n])
        ordered.append((cycle, now_alpha, now_kw))
        over = cycle - renewed >= after
        for _, old_alpha, old_kw in ordered:
            old_alpha[over], old_kw[over] = 1.0, reverts_kw[over]
        # What was ordered a delay ago is in force.
        due = [next(o for o in reversed(ordered) if o[0] <= cycle - wait) for wait in delay]
        ordered = ordered[-int(max(delay)) - 2 :]
        step = ramp_percent / 100.0 * cycle_s * passed
        want = np.array([o[1][n] for n, o in enumerate(due)])
        alpha = np.clip(want, alpha - step, alpha + step)
        want = np.array([o[2][n] for n, o in enumerate(due)])
        held_kw = np.minimum(limit_kw, np.maximum(power_kw, want))  # What it holds back falls.
        limit_kw = np.clip(want, held_kw - step * ratings_kw, held_kw + step * ratings_kw)
        mpp_kw, before = true_mpp_kw(run, cycle), cycle
        free_kw = mpp_kw if plan.control.actuator == "limit" else alpha * mpp_kw
        power_kw = np.minimum(free_kw, limit_kw)
        made = one.sent["production"]
        apart = np.abs(power_kw - made.inverter_power_kw) > EXACT * ratings_kw
        wrong = np.flatnonzero(apart & ~unsure)
        for n in wrong[:1]:
            got = f"{made.inverter_power_kw[n]:,.3f} kW"
            yield cycle, f"{leaves[n]} gives {got}, not {power_kw[n]:,.3f} kW of {mpp_kw[n]:,.1f}"
        told = _stated(run, cycle + 1, "telemetry")
        for n, row in enumerate(told):
            near = EXACT * ratings_kw[n]
            if (
                not unsure[n]
                and max(abs(row.alpha - alpha[n]), abs(row.limit_kw - limit_kw[n])) > near
            ):
                yield cycle, f"{leaves[n]} states {row.alpha:.4f} and {row.limit_kw:,.3f} kW"


def _stated(run: FaultyRun, cycle: int, signal: str) -> list[Any]:
    """Return the plant's messages of a signal in a cycle; empty if it skipped it."""
    ports = [key(leaf, signal) for leaf in run.plan.tree.leaves]
    found = [run.trace.of[port].get(cycle) for port in ports]
    return [] if None in found else [one[0] for one in found if one]


def meters(run: FaultyRun) -> Breaches:
    """Check what the plant measures and states of the interval that ended."""
    plan, near_kw, last_kw, stored_kw = run.plan, EXACT * run.rating_kw(), None, 0.0
    factor = 1.0 + plan.grid.meter_error_percent / 100.0
    for made in run.trace.produced:
        cycle, power_kw = made.cycle, np.array(made.inverter_power_kw)
        now_stored_kw = sum(made.storage_power_kw or ())
        due = {
            "delivered_kw": fed_in_kw(run, power_kw, now_stored_kw),
            "available_kw": fed_in_kw(run, true_mpp_kw(run, cycle), most=1.0),
            "dispatch_kw": run.trace.of["dispatch"][cycle][0].power_kw,
        }
        for name, kw in due.items():
            if abs(getattr(made, name) - kw) > near_kw:
                yield cycle, f"production: {name} {getattr(made, name):,.3f}, not {kw:,.3f}"
        meter = run.trace.of["meter"][cycle][0]
        if last_kw is not None:
            due_kw = fed_in_kw(run, last_kw, stored_kw) * factor
            if run.plan.plants:
                due_kw = sum(_read_kw(run, one, last_kw) for one in run.plan.plants)
            for one in run.plan.plants:
                shown_kw = run.trace.of[key(one.name, "meter")][cycle][0].power_kw
                if abs(shown_kw - _read_kw(run, one, last_kw)) > near_kw:
                    yield cycle, f"the meter of {one.name} shows {shown_kw:,.3f} kW"
            if abs(meter.power_kw - due_kw) > near_kw:
                yield cycle, f"the meter shows {meter.power_kw:,.3f} kW, not {due_kw:,.3f} kW"
            yield from _wrong_telemetry(run, cycle, last_kw)
        if run.profile.frequency_hz.size and meter.frequency_hz != run.profile.frequency_hz[cycle]:
            yield cycle, f"the meter shows {meter.frequency_hz} Hz"
        last_kw, stored_kw = power_kw, now_stored_kw


def memory(run: FaultyRun) -> Breaches:
    """Check that the meter repeats what the central controller stated last, however long ago."""
    fields = ("correction_kw", "error_kw", "expected_kw", "reference_kw")
    of_share = ("lacking_kw", "tried_kw", "helped_share")
    stated, is_known = None, True
    for one in run.applied:
        meter = run.trace.of["meter"][one.cycle][0]
        repeated, due = (
            [getattr(its, name, None) or 0.0 for name in fields + of_share]
            for its in (meter, stated)
        )
        if is_known and repeated != due:
            yield one.cycle, f"the meter repeats {repeated}, not {due}, which was stated last"
        if one.used["memory"] is not None:
            stated, is_known = one.used["memory"], "memory" not in one.doubtful


def _read_kw(run: FaultyRun, one: Any, power_kw: Any) -> float:
    """Return what the meter of a fleet's plant reads."""
    error = one.grid.meter_error_percent / 100.0
    return float(plant_kw(run, power_kw, one.name) * (1.0 + error))


def export(run: FaultyRun) -> Breaches:
    """Check that no plant of a fleet feeds in more than it may for long."""
    for one in run.plan.plants:
        since = 0
        for made in run.trace.produced:
            kw = plant_kw(run, np.array(made.inverter_power_kw), one.name)
            if kw <= one.export_limit_kw * OVER_LIMIT:
                since = made.cycle + 1
            elif made.cycle - since >= OVER_FOR:
                yield made.cycle, f"{one.name} feeds in {kw:,.1f} kW"


def storages(run: FaultyRun) -> Breaches:
    """Check that storages obey within their limits, and that no energy is made or lost."""
    last = {one.path: (0.0, one.state * one.capacity_kwh, 0.0, 0) for one in run.plan.storages}
    before = -1
    for decision in run.applied:
        made, cycle, passed = decision.sent["production"], decision.cycle, decision.cycle - before
        before, time_s = cycle, cycle * run.plan.timing.cycle_s
        for n, one in enumerate(run.plan.storages):
            power_kw, energy_kwh = made.storage_power_kw[n], made.storage_energy_kwh[n]
            last_kw, last_kwh, wanted_kw, renewed = last[one.path]
            command = decision.used[key(one.path, "command")]
            if command is not None and command.cycle >= renewed:
                wanted_kw, renewed = command.power_kw, command.cycle
            if cycle - renewed >= run.plan.control.hold_cycles or _is_tripped(
                run, one.path, time_s
            ):
                wanted_kw = 0.0
            last[one.path] = power_kw, energy_kwh, wanted_kw, renewed
            if passed > 1 or key(one.path, "command") in decision.doubtful:
                continue
            for text in _wrong_storage(
                run, one, (last_kw, last_kwh), (power_kw, energy_kwh), wanted_kw
            ):
                yield cycle, f"{one.path} {text}"


def _wrong_storage(
    run: FaultyRun, one: Any, last: tuple[float, float], now: tuple[float, float], wanted_kw: float
) -> Iterator[str]:
    """Say what is wrong with the power and the energy of a storage after those of a cycle ago."""
    hours, (last_kw, last_kwh), (power_kw, energy_kwh) = _hours(run), last, now
    kept_kwh = last_kwh - min(one.standing_loss_kw * hours, last_kwh)
    per_kw = hours * one.charge_efficiency if power_kw < 0.0 else hours / one.discharge_efficiency
    if abs(energy_kwh - kept_kwh + power_kw * per_kw) > 1e-6:
        yield f"holds {energy_kwh:.6f} kWh"
    step_kw = one.rating_kw * (one.ramp_percent_per_s or inf) / 100.0 * hours * 3600.0
    due_kw = min(max(wanted_kw, last_kw - step_kw, -one.rating_kw), last_kw + step_kw)
    lowest_kwh = one.lowest_state * one.capacity_kwh
    if lowest_kwh + EXACT < energy_kwh < one.highest_state * one.capacity_kwh - EXACT:
        due_kw = min(due_kw, one.rating_kw)
        if abs(power_kw - due_kw) > EXACT * one.rating_kw:
            yield f"gives {power_kw:,.3f} kW, not {due_kw:,.3f} kW"
    elif power_kw > EXACT and energy_kwh < lowest_kwh - EXACT:
        yield f"gives {power_kw:,.3f} kW, with {energy_kwh:.6f} kWh in it"


def _hours(run: FaultyRun) -> float:
    return run.plan.timing.cycle_s / 3600.0


def _is_tripped(run: FaultyRun, node: str, time_s: float) -> bool:
    return any(
        fnmatchcase(node, rule.agents) and rule.at[0] <= time_s < rule.at[1]
        for rule in run.plan.faults.rules
        if isinstance(rule, Trip)
    )


def _wrong_telemetry(run: FaultyRun, cycle: int, last_kw: NDArray[np.float64]) -> Breaches:
    """Check the power that inverters measure, and that they state they could have given."""
    leaves, site, near_kw = run.plan.tree.leaves, run.plan.site, EXACT * run.rating_kw()
    ratings_kw = np.array([run.rating_kw(leaf) for leaf in leaves])
    measured_kw = last_kw * (1.0 + run.profile.meter_error[cycle])
    could_kw = true_mpp_kw(run, cycle - 1) * (1.0 + (site.available_bias or 0.0))
    could_kw = np.minimum(could_kw, ratings_kw)
    for n, one in enumerate(_stated(run, cycle, "telemetry")):
        if abs(one.power_kw - measured_kw[n]) > near_kw:
            yield cycle, f"{leaves[n]} measures {one.power_kw:,.3f}, not {measured_kw[n]:,.3f}"
        if site.states_all and not abs((one.available_kw or nan) - could_kw[n]) <= near_kw:
            yield cycle, f"{leaves[n]} states {one.available_kw} kW, not {could_kw[n]:,.3f}"
