"""Every control scheme on one day: from a prepared run to its series, over arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, cast, get_args

import numpy as np
from numpy.typing import NDArray

from agents.control.grouping import grouping_limits_kw
from agents.plan import Actuator, RunPlan, Scheme
from bus_schemas.errors import InputError
from recordings.read.series import RunSeries
from sim_plant.profile import Profile
from studies.arrays.closed_loop import LoopResult, run_loop

SCHEMES: Final = {
    "uncontrolled": "every inverter at its maximum",
    "uniform-cap": "each inverter limited to its share of the dispatch by capacity",
    "grouping": "reference group at full power, the rest at one uniform limit; see --reference",
    "paper": "hierarchical, IMPP of the last cycle (eq. 1)",
    "predictive": "hierarchical, IMPP forecast with a margin",
    "physical-limit": "the least of dispatch and possible power: no controller does better",
}
"""Name and one line of each scheme."""


@dataclass(frozen=True, slots=True)
class ReferenceGroups:
    """The reference groups that grouping control is tried with.

    Attributes
    ----------
    sizes
        Numbers of inverters in a group.
    choices
        How many groups of each size: every single inverter for size 1, else drawn at random.
    members
        Names of the inverters of one group, in place of all these.
    """

    sizes: tuple[int, ...] = (1, 2, 3, 4, 6, 8)
    choices: int = 12
    seed: int = 1
    members: tuple[str, ...] = ()

    def groups(self, names: Sequence[str]) -> Iterator[NDArray[np.bool_]]:
        """Yield each group as a mask over the inverters of these names."""
        if self.members:
            yield self._named(names)
            return
        inverters = len(names)
        generator = np.random.default_rng(self.seed)
        for size in self.sizes:
            if not 0 < size < inverters:
                raise InputError(
                    f"--reference: expected groups of 1 to {inverters - 1} inverters, got {size}"
                )
            for choice in range(inverters if size == 1 else self.choices):
                members = [choice] if size == 1 else generator.choice(inverters, size, False)
                mask = np.zeros(inverters, dtype=bool)
                mask[members] = True
                yield mask

    def _named(self, names: Sequence[str]) -> NDArray[np.bool_]:
        for name in self.members:
            if name not in names:
                raise InputError(f"--reference: expected {', '.join(names)}, got {name}")
        mask = np.isin(names, self.members)
        if mask.all():
            raise InputError("--reference: expected fewer than all inverters")
        return mask


def run_scheme(
    name: str, plan: RunPlan, profile: Profile, actuator: Actuator, groups: ReferenceGroups
) -> list[RunSeries]:
    """Run one scheme; grouping control gives one series for each reference group.

    The actuator is that of the hierarchical schemes; the others are defined with power limits.

    Raises
    ------
    InputError
        There is no such scheme, or a reference group does not fit the plant.
    """
    if name in get_args(Scheme):
        found = run_loop(plan, profile, cast(Scheme, name), actuator)
        return [_series(name, plan, profile, found)]
    if name == "grouping":
        return _grouping(plan, profile, groups)
    simple = _SIMPLE.get(name)
    if simple is None:
        raise InputError(f"scheme: expected {', '.join(SCHEMES)}, got {name}")
    return [_series(name, plan, profile, _limited(profile, simple(plan, profile)))]


def _grouping(plan: RunPlan, profile: Profile, groups: ReferenceGroups) -> list[RunSeries]:
    rating_kw = _rating_kw(plan)
    measured_kw = _last_cycle(profile.mpp_kw) * (1.0 + profile.meter_error)
    found = []
    names = [leaf.rpartition("/")[2] for leaf in plan.tree.leaves]
    for mask in groups.groups(names):
        limits_kw = grouping_limits_kw(
            measured_kw[:, mask].sum(axis=1), _desired_kw(profile), rating_kw, mask
        )
        members = ",".join(name for name, chosen in zip(names, mask, strict=True) if chosen)
        found.append(_series(f"grouping({members})", plan, profile, _limited(profile, limits_kw)))
    return found


def _uncontrolled(plan: RunPlan, profile: Profile) -> NDArray[np.float64]:
    return np.full_like(profile.mpp_kw, np.inf)


def _uniform_cap(plan: RunPlan, profile: Profile) -> NDArray[np.float64]:
    rating_kw = _rating_kw(plan)
    desired_kw = np.maximum(_desired_kw(profile), 0.0)
    return np.asarray(desired_kw[:, None] * (rating_kw / rating_kw.sum()))


def _physical_limit(plan: RunPlan, profile: Profile) -> NDArray[np.float64]:
    possible_kw = profile.mpp_kw.sum(axis=1)
    wanted_kw = np.clip(_desired_kw(profile), 0.0, possible_kw)
    share = np.divide(wanted_kw, possible_kw, out=np.ones_like(wanted_kw), where=possible_kw > 0.0)
    return np.asarray(profile.mpp_kw * share[:, None])


_SIMPLE: Final[dict[str, Callable[[RunPlan, Profile], NDArray[np.float64]]]] = {
    "uncontrolled": _uncontrolled,
    "uniform-cap": _uniform_cap,
    "physical-limit": _physical_limit,
}
"""Schemes that limit the power of each inverter without looking at the last cycle."""


def _limited(profile: Profile, limits_kw: NDArray[np.float64]) -> LoopResult:
    power_kw = np.minimum(profile.mpp_kw, limits_kw)
    unknown = np.full_like(power_kw, np.nan)
    alpha = np.divide(power_kw, profile.mpp_kw, out=np.ones_like(power_kw), where=power_kw > 0.0)
    return LoopResult(power_kw, unknown, unknown, alpha)


def _series(label: str, plan: RunPlan, profile: Profile, result: LoopResult) -> RunSeries:
    return RunSeries(
        label=label,
        inverters=plan.tree.leaves,
        rating_kw=_rating_kw(plan),
        timezone=plan.timezone,
        start_time_ns=plan.start_time_ns,
        cycle_s=plan.cycle_ns / 1e9,
        commitment_kw=profile.commitment_kw,
        regulation_kw=profile.regulation_kw,
        regulation_capacity_kw=profile.regulation_capacity_kw,
        mpp_kw=profile.mpp_kw,
        power_kw=result.power_kw,
        impp_kw=result.impp_kw,
        residual_kw=result.residual_kw,
        alpha=result.alpha,
        ramp_limit_percent_per_min=plan.ramp_limit_percent_per_min,
    )


def _desired_kw(profile: Profile) -> NDArray[np.float64]:
    return profile.commitment_kw + profile.regulation_kw


def _rating_kw(plan: RunPlan) -> NDArray[np.float64]:
    return np.array([plan.tree.rating_kw(leaf) for leaf in plan.tree.leaves])


def _last_cycle(value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values of the cycle before; the first cycle repeats its own."""
    return np.concatenate([value[:1], value[:-1]])
