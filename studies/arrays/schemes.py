"""Every control scheme on one day: from a prepared run to its series, over arrays."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, TypeAlias, cast, get_args

import numpy as np
from numpy.typing import NDArray

from agents.control.grid import gross_kw
from agents.control.grouping import grouping_levels, grouping_limits_kw
from agents.plan import RunPlan
from agents.settings import Actuator, Scheme
from bus_schemas.errors import InputError
from recordings.read.series import RunSeries
from scenarios.scenario import Scenario
from sim_plant.inverters import Inverters, towards
from sim_plant.orders import planned
from sim_plant.profile import Profile
from sim_plant.without_help import powers_without_help_kw
from studies.arrays.closed_loop import run_loop

SCHEMES: Final = {
    "uncontrolled": "every inverter at its maximum",
    "uniform-cap": "each inverter held to its share of the dispatch by rating",
    "grouping": "reference group at full power, the rest curtailed alike",
    "paper": "hierarchical, IMPP of the last cycle (eq. 1)",
    "predictive": "hierarchical, IMPP forecast, target corrected by the meter",
    "physical-limit": "the least of dispatch and available power: no controller does better",
}
"""Name and one line of each scheme."""

Groups: TypeAlias = Iterable[NDArray[np.bool_]] | None
"""Reference groups of grouping control, as masks over the inverters."""

BOUNDS: Final = ("uncontrolled", "physical-limit")
"""Schemes that command nothing: they have no actuator, and say what is possible."""

_OF_ONE_PLANT: Final = ("grouping", "physical-limit")

_SIZES: Final = (1, 2, 3, 4, 6, 8)
_CHOICES: Final = 12
"""Sizes of the reference groups that are tried, and how many of each."""


def schemes_for(scenario: Scenario) -> tuple[str, ...]:
    """Return all schemes, of a fleet those that know plants."""
    return tuple(name for name in SCHEMES if not scenario.plants or name not in _OF_ONE_PLANT)


def reference_groups(inverters: int, sizes: Sequence[int] = _SIZES) -> Iterator[NDArray[np.bool_]]:
    """Yield the groups that grouping control is tried with, each as a mask over the inverters.

    Of each size that the plant is large enough for, some groups are drawn at random; of size 1,
    every single inverter.
    """
    if inverters < 2:
        raise InputError.of("--schemes", "expected two inverters or more with grouping, got one")
    generator = np.random.default_rng(1)
    for size in (size for size in sizes if size < inverters):
        for choice in range(inverters if size == 1 else _CHOICES):
            members = [choice] if size == 1 else generator.choice(inverters, size, False)
            mask = np.zeros(inverters, dtype=bool)
            mask[members] = True
            yield mask


def run_scheme(
    name: str, plan: RunPlan, profile: Profile, actuator: Actuator, groups: Groups = None
) -> list[RunSeries]:
    """Run one of `SCHEMES`; grouping control gives one series for each reference group.

    By default these are `reference_groups`.
    """
    if plan.grid.moves_target:
        raise InputError.of(
            "grid",
            "expected losses and meter_error_percent alone, since a study over arrays has no "
            "ramp limits and no frequency response; use simulate",
        )
    if plan.plants and name in _OF_ONE_PLANT:
        raise InputError.of("--schemes", f"expected schemes that know plants, got {name}")
    if name in get_args(Scheme):
        results = [run_loop(plan, profile, cast(Scheme, name), actuator)._asdict()]
    else:
        profile = _as_offered(plan, profile, actuator)
        powers_kw = _powers_kw(name, plan, profile, actuator, groups)
        results = [{"power_kw": kw, "alpha": _share(kw, profile.mpp_kw)} for kw in powers_kw]
    of_plant = {
        "commitment_kw": profile.commitment_kw,
        **planned(plan, profile)._asdict(),
        "mpp_kw": profile.mpp_kw,
    }
    series = [RunSeries.of(plan, name, of_plant | result) for result in results]
    # Every message arrives here.
    return [
        dataclasses.replace(one, of_agents={"missed-inputs": 0, "reverted": 0.0}) for one in series
    ]


def _as_offered(plan: RunPlan, profile: Profile, actuator: Actuator) -> Profile:
    """Return a profile with the commitment that the plan's own scheme offers, if it offers one."""
    if plan.control.offers is None:
        return profile
    run = run_loop(plan, profile, plan.control.scheme, actuator)
    return dataclasses.replace(profile, commitment_kw=run.dispatch_kw - profile.regulation_kw)


def _powers_kw(
    name: str, plan: RunPlan, profile: Profile, actuator: Actuator, groups: Groups
) -> Iterator[NDArray[np.float64]]:
    match name:
        case "uncontrolled":
            yield profile.mpp_kw
        case "uniform-cap":
            sky_and_aim = profile.mpp_kw, _dispatch_kw(plan, profile)
            yield powers_without_help_kw(plan, *sky_and_aim, actuator, profile.meter_error)
        case "grouping":
            yield from _grouping(plan, profile, actuator, groups)
        case "physical-limit":
            available_kw, law = profile.mpp_kw.sum(axis=1), plan.grid_law
            gross = [gross_kw(kw, law) for kw in _dispatch_kw(plan, profile).tolist()]
            wanted_kw = np.clip(gross, 0.0, available_kw)
            yield profile.mpp_kw * _share(wanted_kw, available_kw)[:, None]


def _grouping(
    plan: RunPlan, profile: Profile, actuator: Actuator, groups: Groups
) -> Iterator[NDArray[np.float64]]:
    rating_kw = _rating_kw(plan)
    measured_kw = _measured_maximum_kw(profile)
    aim_kw = _dispatch_kw(plan, profile) + plan.control.offset_kw
    for mask in reference_groups(len(rating_kw)) if groups is None else groups:
        seen = measured_kw[:, mask].sum(axis=1), aim_kw, rating_kw, mask
        if actuator == "limit":
            limits_kw = np.minimum(grouping_limits_kw(*seen), rating_kw)
            yield np.minimum(profile.mpp_kw, _obeyed(plan, limits_kw, rating_kw))
        else:
            levels = grouping_levels(*seen)
            yield profile.mpp_kw * _obeyed(plan, levels, np.ones_like(rating_kw))


def _obeyed(
    plan: RunPlan, commanded: NDArray[np.float64], full: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return what is in force of commands, shape (T, n), by delay and ramp; `full` is the most.

    It begins with the first command.
    """
    inverters = Inverters(plan)
    at = np.arange(len(commanded))[:, None] - inverters.delay_cycles
    found = np.take_along_axis(commanded, np.maximum(at, 0), axis=0)
    step = inverters.ramp_per_cycle * full
    if np.isfinite(step).any():
        for cycle in range(1, len(found)):
            found[cycle] = towards(found[cycle], found[cycle - 1], step)
    return found


def _share(power_kw: NDArray[np.float64], of_kw: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a power as a share of another; 1 where that other is 0."""
    return np.divide(power_kw, of_kw, out=np.ones_like(power_kw), where=of_kw > 0.0)


def _dispatch_kw(plan: RunPlan, profile: Profile) -> NDArray[np.float64]:
    return planned(plan, profile).dispatch_kw


def _rating_kw(plan: RunPlan) -> NDArray[np.float64]:
    return np.array([plan.tree.rating_kw(leaf) for leaf in plan.tree.leaves])


def _measured_maximum_kw(profile: Profile) -> NDArray[np.float64]:
    """Return what the meters show of each maximum a cycle ago; the first cycle shows its own."""
    last_kw = np.concatenate([profile.mpp_kw[:1], profile.mpp_kw[:-1]])
    return np.asarray(last_kw * (1.0 + profile.meter_error))
