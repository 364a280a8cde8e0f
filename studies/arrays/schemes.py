"""Every control scheme on one day: from a prepared run to its series, over arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, cast, get_args

import numpy as np
from numpy.typing import NDArray

from agents.control.grouping import grouping_levels, grouping_limits_kw
from agents.plan import RunPlan
from agents.settings import Actuator, Scheme
from bus_schemas.errors import InputError
from recordings.read.series import RunSeries
from sim_plant.profile import Profile
from studies.arrays.closed_loop import LoopResult, run_loop

SCHEMES: Final = {
    "uncontrolled": "every inverter at its maximum",
    "uniform-cap": "each inverter held to its share of the dispatch by rating",
    "grouping": "reference group at full power, the rest curtailed alike; see --reference",
    "paper": "hierarchical, IMPP of the last cycle (eq. 1)",
    "predictive": "hierarchical, IMPP forecast with a margin",
    "physical-limit": "the least of dispatch and possible power: no controller does better",
}
"""Name and one line of each scheme."""

BOUNDS: Final = ("uncontrolled", "physical-limit")
"""Schemes that command nothing: they have no actuator, and say what is possible."""


_SIZES: Final = (1, 2, 3, 4, 6, 8)
"""Sizes of the reference groups that are tried if none are given."""


@dataclass(frozen=True, slots=True)
class ReferenceGroups:
    """The reference groups that grouping control is tried with.

    So many choices of each size are drawn at random; of size 1, every single inverter. Without
    sizes, all that the plant is large enough for are tried. `members` names the inverters of one
    group in place of all these.
    """

    sizes: tuple[int, ...] = ()
    choices: int = 12
    seed: int = 1
    members: tuple[str, ...] = ()

    def groups(self, names: Sequence[str]) -> Iterator[NDArray[np.bool_]]:
        """Yield each group as a mask over the inverters of these names."""
        inverters = len(names)
        if inverters < 2:
            raise InputError("--schemes: expected two inverters or more with grouping, got one")
        if self.members:
            for name in self.members:
                if name not in names:
                    raise InputError(f"--reference: expected {', '.join(names)}, got {name}")
            if len(set(self.members)) == inverters:
                raise InputError("--reference: expected fewer than all inverters")
            yield np.isin(names, self.members)
            return
        generator = np.random.default_rng(self.seed)
        for size in self.sizes or [size for size in _SIZES if size < inverters]:
            if not 0 < size < inverters:
                raise InputError(
                    f"--reference: expected groups of 1 to {inverters - 1} inverters, got {size}"
                )
            for choice in range(inverters if size == 1 else self.choices):
                members = [choice] if size == 1 else generator.choice(inverters, size, False)
                mask = np.zeros(inverters, dtype=bool)
                mask[members] = True
                yield mask


def run_scheme(
    name: str, plan: RunPlan, profile: Profile, actuator: Actuator, groups: ReferenceGroups
) -> list[RunSeries]:
    """Run one of `SCHEMES`; grouping control gives one series for each reference group."""
    if name in get_args(Scheme):
        found = run_loop(plan, profile, cast(Scheme, name), actuator)
        return [_series(name, plan, profile, found)]
    if name == "grouping":
        return _grouping(plan, profile, actuator, groups)
    power_kw = profile.mpp_kw
    if name == "uniform-cap":
        power_kw = _uniform_cap(plan, profile, actuator)
    if name == "physical-limit":
        possible_kw = profile.mpp_kw.sum(axis=1)
        wanted_kw = np.clip(_desired_kw(profile), 0.0, possible_kw)
        share = np.ones_like(wanted_kw)
        np.divide(wanted_kw, possible_kw, out=share, where=possible_kw > 0.0)
        power_kw = np.asarray(profile.mpp_kw * share[:, None])
    return [_series(name, plan, profile, _result(profile, power_kw))]


def _grouping(
    plan: RunPlan, profile: Profile, actuator: Actuator, groups: ReferenceGroups
) -> list[RunSeries]:
    rating_kw = _rating_kw(plan)
    measured_kw = _measured_maximum_kw(profile)
    found = []
    names = [leaf.rpartition("/")[2] for leaf in plan.tree.leaves]
    for mask in groups.groups(names):
        seen = measured_kw[:, mask].sum(axis=1), _desired_kw(profile), rating_kw, mask
        if actuator == "limit":
            power_kw = np.minimum(profile.mpp_kw, grouping_limits_kw(*seen))
        else:
            power_kw = profile.mpp_kw * grouping_levels(*seen)
        members = ",".join(name for name, chosen in zip(names, mask, strict=True) if chosen)
        found.append(_series(f"grouping({members})", plan, profile, _result(profile, power_kw)))
    return found


def _uniform_cap(plan: RunPlan, profile: Profile, actuator: Actuator) -> NDArray[np.float64]:
    """Each inverter gives its request; behind a fraction, of what it could give a cycle ago."""
    rating_kw = _rating_kw(plan)
    dispatch_kw = np.clip(_desired_kw(profile), 0.0, rating_kw.sum())
    request_kw = np.outer(dispatch_kw, rating_kw / rating_kw.sum())
    if actuator == "limit":
        return np.minimum(profile.mpp_kw, request_kw)
    impp_kw = np.minimum(_measured_maximum_kw(profile), rating_kw)
    level = np.ones_like(impp_kw)
    np.divide(request_kw, impp_kw, out=level, where=impp_kw > request_kw)
    return np.asarray(profile.mpp_kw * np.maximum(level, plan.alpha_min))


def _result(profile: Profile, power_kw: NDArray[np.float64]) -> LoopResult:
    unknown = np.full_like(power_kw, np.nan)
    alpha = np.divide(power_kw, profile.mpp_kw, out=np.ones_like(power_kw), where=power_kw > 0.0)
    return LoopResult(power_kw, unknown, unknown, alpha)


def _series(label: str, plan: RunPlan, profile: Profile, result: LoopResult) -> RunSeries:
    return RunSeries.of(
        plan,
        label,
        commitment_kw=profile.commitment_kw,
        regulation_kw=profile.regulation_kw,
        mpp_kw=profile.mpp_kw,
        power_kw=result.power_kw,
        impp_kw=result.impp_kw,
        residual_kw=result.residual_kw,
        alpha=result.alpha,
    )


def _desired_kw(profile: Profile) -> NDArray[np.float64]:
    return profile.commitment_kw + profile.regulation_kw


def _rating_kw(plan: RunPlan) -> NDArray[np.float64]:
    return np.array([plan.tree.rating_kw(leaf) for leaf in plan.tree.leaves])


def _measured_maximum_kw(profile: Profile) -> NDArray[np.float64]:
    """Return what the meters show of each maximum a cycle ago; the first cycle shows its own."""
    last_kw = np.concatenate([profile.mpp_kw[:1], profile.mpp_kw[:-1]])
    return np.asarray(last_kw * (1.0 + profile.meter_error))
