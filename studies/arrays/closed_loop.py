"""The whole hierarchy and its plant as one loop over the cycles of a run.

It calls the functions of `agents.control` in the order in which agents call them when all messages
arrive, and Numba compiles it together with them. So a study of thousands of days needs no second
copy of the control law, and gives the same bits as the agents.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import ceil, inf, isnan, nan
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agents.control.allocation import allocate, total
from agents.control.correction import (
    Correction,
    CorrectionLaw,
    corrected,
    corrected_kw,
    nothing_metered,
    with_reading,
)
from agents.control.fleet import feedable_kw
from agents.control.forecast import HIDDEN_ALPHA_MIN, Reading, forecast_impp, held_kw
from agents.control.grid import GridLaw, net_kw
from agents.control.impp import (
    NOTHING_KNOWN,
    Estimate,
    curtailment_level,
    estimate_impp,
    is_lost,
)
from agents.control.offers import (
    NO_OFFERS,
    OfferMemory,
    OfferSettings,
    begin_run,
    memory_of,
    nothing_offered,
    observe,
)
from agents.control.share import share_kw, usable_dispatch_kw
from agents.control.storage import Course, Pursuit
from agents.plan import RunPlan
from agents.settings import Actuator, Scheme
from bus_schemas.errors import InputError
from sim_plant.inverters import Inverters, limit_towards, stated_kw, towards
from sim_plant.orders import planned
from sim_plant.profile import Profile
from studies.arrays.compiled import compiled
from studies.arrays.control_arrays import ControlArrays, control_arrays, is_corrected
from studies.arrays.plant_arrays import PlantArrays, grid_law, metered_kw, read_meters
from studies.arrays.storage_arrays import (
    StorageArrays,
    ask_storages,
    divide,
    obey_storages,
    state_abilities,
)

Floats: TypeAlias = NDArray[np.float64]


KEPT_TURNS: Final = 32
"""The number of kept aims is a multiple of this: Numba compiles anew for each length of a tuple."""


class LoopSettings(NamedTuple):
    """The settings of a run besides its control tree.

    Whether the IMPP is a forecast or that of the last cycle; whether inverters hold a power limit
    or give a fraction of their maximum; whether the target is corrected by the plant's meter; how
    much more than the dispatch the plant aims at; what is lost up to the meter, and its error;
    whether storages also give what inverters could, and how these follow.
    """

    is_forecast: bool
    is_limited: bool
    correction: CorrectionLaw
    alpha_min: float
    cycle_s: float
    hold_cycles: int
    grid: GridLaw
    meter_error: float
    has_help: bool
    helps_first: bool
    pursuit: Pursuit


class Obedience(NamedTuple):
    """How inverters follow commands, as `Inverters.obey` has it. The loop changes it in place.

    delay_cycles: After how many cycles a command takes effect, shape (n,).
    ramp_per_cycle: Largest change in a cycle, as a share of the rating, shape (n,).
    alpha, limit_kw: What is in force, shape (n,); before the run what they hold until they obey
        their first command.
    ordered_alpha, ordered_kw: The last commands in turn, shape (longest delay + 1, n).
    """

    delay_cycles: NDArray[np.int64]
    ramp_per_cycle: Floats
    alpha: Floats
    limit_kw: Floats
    ordered_alpha: Floats
    ordered_kw: Floats


class Schedule(NamedTuple):
    """What the operator wants, shape (cycles,). Offers change commitment and dispatch in place.

    clear_sky_kw: What the plant would have under a clear sky; 0 without offers.
    offers, memory: How the commitment is offered, see `agents.control.offers`.
    """

    dispatch_kw: Floats
    commitment_kw: Floats
    regulation_kw: Floats
    clear_sky_kw: Floats
    offers: OfferSettings
    memory: OfferMemory


class LoopInputs(NamedTuple):
    """The arguments of `closed_loop`; arrays of shape (cycles, n).

    known, course: What the central controller knows of meter and inverters before the run.
    """

    tree: ControlArrays
    settings: LoopSettings
    mpp_kw: Floats
    schedule: Schedule
    meter_error: Floats
    available_kw: Floats
    obedience: Obedience
    known: Correction
    storages: StorageArrays
    course: Course
    plants: PlantArrays


class LoopResult(NamedTuple):
    """What was wanted, of shape (cycles,); power, estimates and commands of shape (cycles, n).

    `storage_power_kw` and `storage_energy_kwh` are of shape (cycles, m).
    """

    dispatch_kw: Floats
    commitment_kw: Floats
    power_kw: Floats
    impp_kw: Floats
    residual_kw: Floats
    alpha: Floats
    storage_power_kw: Floats
    storage_energy_kwh: Floats


def run_loop(
    plan: RunPlan,
    profile: Profile,
    scheme: Scheme,
    actuator: Actuator,
    record: Floats | None = None,
    *,
    has_help: bool = True,
) -> LoopResult:
    """Run a plan's hierarchy on a profile with this scheme and actuator in place of its own.

    record: What the offers of earlier runs left; this run adds to it, in place.
    has_help: Otherwise no inverter counts for more than its share of the dispatch, and of what
        charges the storages.
    """
    inputs = loop_inputs(plan, profile, scheme, actuator, record)
    settings = inputs.settings._replace(has_help=has_help)
    return _compiled_loop()(*inputs._replace(settings=settings))


@cache
def _compiled_loop() -> Callable[..., LoopResult]:
    return compiled(closed_loop)


def loop_inputs(
    plan: RunPlan,
    profile: Profile,
    scheme: Scheme,
    actuator: Actuator,
    record: Floats | None = None,
) -> LoopInputs:
    is_forecast, is_limited = scheme == "predictive", actuator == "limit"
    law = plan.correction_law()
    kept_turns = ceil(law.kept_turns / KEPT_TURNS) * KEPT_TURNS
    law = law._replace(is_on=is_corrected(plan, scheme), kept_turns=kept_turns)
    settings = LoopSettings(
        is_forecast=is_forecast,
        is_limited=is_limited,
        correction=law,
        alpha_min=HIDDEN_ALPHA_MIN if is_forecast and is_limited else plan.control.alpha_min,
        cycle_s=plan.timing.cycle_ns / 1e9,
        hold_cycles=plan.control.hold_cycles,
        grid=plan.grid_law,
        meter_error=plan.grid.meter_error_percent / 100.0,
        has_help=True,
        helps_first=plan.control.storage == "first",
        pursuit=plan.pursuit,
    )
    plan = replace(plan, control=replace(plan.control, actuator=actuator))
    schedule = _schedule(plan, profile, record)
    tree, storages, plants = control_arrays(plan, profile.cycles, law.is_on)
    kept_asked = ceil((settings.pursuit.delay + 1) / KEPT_TURNS) * KEPT_TURNS
    return LoopInputs(
        tree,
        settings,
        profile.mpp_kw,
        schedule,
        profile.meter_error,
        _available_kw(plan, profile),
        _obedience(plan, profile, schedule),
        nothing_metered(settings.correction),
        storages,
        Course((nan,) * kept_asked, nan),
        plants,
    )


def _obedience(plan: RunPlan, profile: Profile, schedule: Schedule) -> Obedience:
    inverters = Inverters(plan)
    first_kw = schedule.dispatch_kw[0]
    if schedule.offers.interval_cycles > 0:
        first_kw = (
            schedule.offers.first_share * schedule.clear_sky_kw[0] + schedule.regulation_kw[0]
        )
    alpha, limit_kw = inverters.first_held(profile.mpp_kw[0], float(first_kw))
    kept = (1 + max(inverters.delay_cycles), 1)
    ordered = np.tile(alpha, kept), np.tile(limit_kw, kept)
    return Obedience(
        inverters.delay_cycles, inverters.ramp_per_cycle, alpha, limit_kw.copy(), *ordered
    )


def _schedule(plan: RunPlan, profile: Profile, record: Floats | None) -> Schedule:
    offers = plan.offer_law
    if offers is not None and plan.orders:
        raise InputError.of("orders", "expected none in a study over arrays with offers")
    settings = NO_OFFERS if offers is None else offers
    memory = memory_of(nothing_offered(settings) if record is None else record, settings)
    begin_run(memory, settings)
    return Schedule(
        planned(plan, profile).dispatch_kw.copy(),
        profile.commitment_kw.copy(),
        profile.regulation_kw,
        np.zeros(profile.cycles) if offers is None else profile.clear_sky_kw,
        settings,
        memory,
    )


def _available_kw(plan: RunPlan, profile: Profile) -> Floats:
    """Return the available power that each inverter states of the last interval, or NaN."""
    ended_kw = np.concatenate([profile.mpp_kw[:1], profile.mpp_kw[:-1]])
    rating_kw = np.array([plan.tree.rating_kw(leaf) for leaf in plan.tree.leaves])
    return stated_kw(ended_kw, rating_kw, plan.site)


def closed_loop(
    tree: ControlArrays,
    settings: LoopSettings,
    mpp_kw: Floats,
    schedule: Schedule,
    meter_error: Floats,
    available_kw: Floats,
    obedience: Obedience,
    known: Correction,
    storages: StorageArrays,
    course: Course,
    plants: PlantArrays,
) -> LoopResult:
    cycles, inverters = mpp_kw.shape
    shares = np.full(2, schedule.offers.first_share)
    power_kw = np.empty((cycles, inverters))
    impp_kw = np.empty((cycles, inverters))
    residuals_kw = np.empty((cycles, inverters))
    alpha = np.empty((cycles, inverters))
    plant_rating_kw = tree.rating_kw[0]
    last_kw = mpp_kw[0].copy()
    level = np.ones(inverters)
    rating_kw = tree.rating_kw[tree.inverters]
    limit_kw = rating_kw.copy()
    estimates = [NOTHING_KNOWN for _ in range(inverters)]
    known_of_plants = [known for _ in range(len(plants.read_kw))]
    node_impp_kw = np.zeros(len(tree.rating_kw))
    target_kw = tree.rating_kw.copy()
    for cycle in range(cycles):
        measured_kw = last_kw * (1.0 + meter_error[cycle])
        for i in range(inverters):
            estimates[i] = estimate(
                settings,
                measured_kw[i],
                level[i],
                available_kw[cycle, i],
                limit_kw[i],
                rating_kw[i],
                estimates[i],
            )
        charge_kw = inf if settings.has_help else state_abilities(storages, plants).charge_kw
        most_share = (schedule.dispatch_kw[cycle] + charge_kw) / plant_rating_kw
        report_up(tree, settings, estimates, most_share, node_impp_kw, plants)
        possible_kw = net_kw(node_impp_kw[0], settings.grid)
        read_kw = read_meters(
            plants, last_kw, storages.power_kw, settings.grid, settings.meter_error
        )
        if schedule.offers.interval_cycles > 0:
            follow_offers(schedule, shares, cycle, possible_kw, read_kw if cycle > 0 else nan)
        heard_kw = usable_dispatch_kw(schedule.dispatch_kw[cycle], plant_rating_kw)
        if cycle > 0:
            known = with_reading(known, read_kw)
            for plant in range(len(known_of_plants)):
                known_of_plants[plant] = with_reading(known_of_plants[plant], plants.read_kw[plant])
        able = state_abilities(storages, plants)
        if cycle % tree.period[0] == 0:
            known = corrected(known, heard_kw, possible_kw, 0.0, settings.correction)
            target_kw[0], course = ask_storages(
                storages,
                corrected_kw(known, settings.correction, settings.grid),
                node_impp_kw[0],
                known.error_kw,
                able,
                course,
                settings.pursuit,
                settings.helps_first,
            )
        solve_down(
            cycle, tree, settings, node_impp_kw, target_kw, storages, plants, known_of_plants
        )
        for i in range(inverters):
            node = tree.inverters[i]
            own_kw = share_kw(heard_kw, tree.sharing_kw[i], plant_rating_kw)
            residuals_kw[cycle, i] = node_impp_kw[node] - own_kw
            impp_kw[cycle, i] = node_impp_kw[node]
            is_gone = is_lost(estimates[i], settings.hold_cycles)
            asked_kw = own_kw if is_gone else target_kw[node]
            share = curtailment_level(asked_kw, estimates[i].power_kw, settings.alpha_min)
            alpha[cycle, i], held_at_kw = share, rating_kw[i]
            if settings.is_limited:
                held_at_kw = commanded_kw(settings, share, asked_kw, rating_kw[i], estimates[i])
                held_at_kw = own_kw if is_gone else held_at_kw
            obey(obedience, cycle, i, share, held_at_kw, last_kw[i], rating_kw[i])
            level[i], limit_kw[i] = obedience.alpha[i], obedience.limit_kw[i]
            share = 1.0 if settings.is_limited else level[i]
            power_kw[cycle, i] = last_kw[i] = min(share * mpp_kw[cycle, i], limit_kw[i])
        obey_storages(storages, cycle)
    return LoopResult(
        schedule.dispatch_kw,
        schedule.commitment_kw,
        power_kw,
        impp_kw,
        residuals_kw,
        alpha,
        storages.powers_kw,
        storages.energies_kwh,
    )


def obey(
    obedience: Obedience,
    cycle: int,
    inverter: int,
    alpha: float,
    limit_kw: float,
    last_kw: float,
    rating_kw: float,
) -> None:
    """Command an inverter, which gave `last_kw`, and move on what is in force."""
    kept = len(obedience.ordered_kw)
    obedience.ordered_alpha[cycle % kept, inverter] = alpha
    obedience.ordered_kw[cycle % kept, inverter] = limit_kw
    obeyed = (cycle - obedience.delay_cycles[inverter]) % kept
    ramp = obedience.ramp_per_cycle[inverter]
    wanted, wanted_kw = (
        obedience.ordered_alpha[obeyed, inverter],
        obedience.ordered_kw[obeyed, inverter],
    )
    obedience.alpha[inverter] = towards(wanted, obedience.alpha[inverter], ramp)
    obedience.limit_kw[inverter] = limit_towards(
        wanted_kw, obedience.limit_kw[inverter], last_kw, ramp * rating_kw
    )


def follow_offers(
    schedule: Schedule, shares: Floats, cycle: int, impp_kw: float, metered_kw: float
) -> None:
    """Work out what is wanted; `shares` are those of this interval and of the coming one."""
    clear_sky_kw = schedule.clear_sky_kw[cycle]
    if cycle % schedule.offers.interval_cycles == 0:
        shares[0] = shares[1]
    schedule.commitment_kw[cycle] = shares[0] * clear_sky_kw
    schedule.dispatch_kw[cycle] = schedule.commitment_kw[cycle] + schedule.regulation_kw[cycle]
    offered = observe(
        schedule.memory,
        schedule.offers,
        cycle,
        impp_kw,
        metered_kw,
        schedule.dispatch_kw[cycle],
        clear_sky_kw,
    )
    if not isnan(offered):
        shares[1] = offered


def estimate(
    settings: LoopSettings,
    power_kw: float,
    alpha: float,
    available_kw: float,
    limit_kw: float,
    rating_kw: float,
    last: Estimate,
) -> Estimate:
    """Estimate an inverter's maximum, as its direct controller does from its telemetry."""
    if not settings.is_forecast:
        return estimate_impp(power_kw, alpha, available_kw, rating_kw, last)
    share = 1.0 if settings.is_limited else alpha
    reading = Reading(power_kw, share, available_kw, limit_kw)
    return forecast_impp(reading, rating_kw, settings.cycle_s, last)


def commanded_kw(
    settings: LoopSettings, share: float, target_kw: float, rating_kw: float, last: Estimate
) -> float:
    """Return the power limit of an inverter that is asked for a share of its maximum."""
    if share < 1.0:
        return share * last.power_kw
    return held_kw(target_kw, rating_kw, last) if settings.is_forecast else rating_kw


def report_up(
    tree: ControlArrays,
    settings: LoopSettings,
    estimates: list[Estimate],
    most_share: float,
    impp_kw: Floats,
    plants: PlantArrays,
) -> None:
    """Add up the IMPPs, each up to a share of the rating, from the inverters to the root."""
    for i in range(len(estimates)):
        node = tree.inverters[i]
        own_kw = min(estimates[i].power_kw, most_share * tree.rating_kw[node])
        impp_kw[node] = 0.0 if is_lost(estimates[i], settings.hold_cycles) else own_kw
    for row in range(len(tree.parents) - 1, -1, -1):
        node = tree.parents[row]
        impp_kw[node] = total(impp_kw[tree.first[row] : tree.end[row]])
        plant = plants.of_node[node]
        if plant >= 0:
            plants.impp_kw[plant] = impp_kw[node]
            impp_kw[node] = feedable_kw(impp_kw[node], grid_law(plants, plant))


def solve_down(
    cycle: int,
    tree: ControlArrays,
    settings: LoopSettings,
    impp_kw: Floats,
    target_kw: Floats,
    storages: StorageArrays,
    plants: PlantArrays,
    known: list[Correction],
) -> None:
    """Divide each parent's last target among its children in its turns, from the root down."""
    for row in range(len(tree.parents)):
        if cycle % tree.period[row] == 0:
            first, end = tree.first[row], tree.end[row]
            node = tree.parents[row]
            kept_turns = settings.correction.kept_turns
            own_kw = metered_kw(plants, node, target_kw[node], known, kept_turns)
            for parent in range(1, len(storages.row)):
                if storages.row[parent] == row:
                    own = storages.own[parent]
                    of_stores_kw = divide(storages, parent, storages.asked_kw[own])
                    own_kw = max(own_kw - of_stores_kw, 0.0)
            setpoints_kw, _, _, _, _ = allocate(
                own_kw,
                tree.rating_kw[first:end],
                impp_kw[first:end],
                settings.alpha_min,
                tree.order[tree.hour[cycle], row],
                settings.is_forecast,
            )
            for child in range(end - first):
                target_kw[first + child] = setpoints_kw[child]
            for parent in range(len(storages.row)):
                if storages.row[parent] == row:
                    for node in range(storages.first[parent], storages.end[parent]):
                        if storages.in_tree[node] >= 0:
                            target_kw[storages.in_tree[node]] += storages.asked_kw[node]
