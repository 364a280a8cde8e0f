"""The baseline of every run: the same sky and inverters, each held to its own share, no help."""

from __future__ import annotations

from math import inf, isfinite

import numpy as np

from agents.control.grid import GridLaw, gross_kw
from agents.plan import RunPlan
from agents.settings import Actuator
from bus_schemas.tree import ROOT
from sim_plant import Floats


def powers_without_help_kw(
    plan: RunPlan,
    mpp_kw: Floats,
    desired_kw: Floats,
    actuator: Actuator,
    meter_error: Floats | float = 0.0,
) -> Floats:
    """Return what each inverter gives if none covers for another, shape (T, n) [kW].

    Each is commanded its share of the desired power by rating (paper, eq. 3), and obeys with its
    delay and ramp. It begins with its share of the first cycle. Behind the actuator `fraction` it
    gives the share as a fraction of what its meter showed of its maximum a cycle ago.

    Parameters
    ----------
    plan
        Of the run: ratings, delays, ramps, losses and offset.
    mpp_kw
        True maximum power of each inverter, shape (T, n); NaN where it is unknown.
    desired_kw
        What the plant is to give at its meter in each cycle, shape (T,).
    meter_error
        Relative error of the inverters' meters, a number or shape (T, n).
    """
    tree = plan.tree
    rating_kw = np.array([tree.rating_kw(leaf) for leaf in tree.leaves])
    aim_kw = _gross_kw(desired_kw + plan.control.offset_kw, plan.grid_law)
    share_kw = np.empty_like(mpp_kw)
    kinds = _kinds(plan)
    for node in tree.meters[1:] or tree.meters:
        own_kw = aim_kw
        if node:
            law, part = plan.grid_laws[node], tree.rating_kw(node) / tree.rating_kw(ROOT)
            own_kw = _gross_kw(np.minimum(aim_kw * part, law.pmax_kw), law)
        below = tree.leaves_below(node)
        level = np.clip(own_kw / rating_kw[list(below)].sum(), 0.0, 1.0)
        for kind in dict.fromkeys(kinds[at] for at in below):
            alike = [at for at in below if kinds[at] == kind]
            obeyed = _obeyed(level, plan.timing.cycle_s, *kind)
            share_kw[:, alike] = np.outer(obeyed, rating_kw[alike])
    if actuator == "limit":
        return np.minimum(mpp_kw, share_kw)
    metered_kw = np.concatenate([mpp_kw[:1], mpp_kw[:-1]]) * (1.0 + meter_error)
    impp_kw = np.minimum(metered_kw, rating_kw)
    fraction = np.divide(share_kw, impp_kw, out=np.ones_like(share_kw), where=impp_kw > 0.0)
    return np.asarray(mpp_kw * np.clip(fraction, plan.control.alpha_min, 1.0))


def _gross_kw(net_kw: Floats, law: GridLaw) -> Floats:
    if not (law.loss_kw or law.loss_per_kw):
        return net_kw
    return np.array([gross_kw(kw, law) for kw in net_kw.tolist()])


def settling_cycles(plan: RunPlan) -> int:
    """Return after how many cycles no inverter is still on its way to an older command."""
    seconds = max(delay_s + 100.0 / ramp for delay_s, ramp in _kinds(plan))
    return int(np.ceil(seconds / plan.timing.cycle_s))


def _kinds(plan: RunPlan) -> list[tuple[float, float]]:
    """Return delay [s] and ramp [%/s] of each inverter."""
    settings = [plan.site.settings_of(leaf) for leaf in plan.tree.leaves]
    return [(one.delay_s or 0.0, one.ramp_percent_per_s or inf) for one in settings]


def _obeyed(level: Floats, cycle_s: float, delay_s: float, ramp_percent_per_s: float) -> Floats:
    """Return a commanded share of the rating as inverters obey it, later and within their ramp."""
    delay = min(int(np.ceil(round(delay_s / cycle_s, 9))), len(level))
    delayed = np.concatenate([np.repeat(level[:1], delay), level[: len(level) - delay]])
    if ramp_percent_per_s == inf:
        return delayed
    step, now = ramp_percent_per_s / 100.0 * cycle_s, float(delayed[0])
    obeyed = np.empty_like(delayed)
    for cycle, wanted in enumerate(delayed.tolist()):
        if isfinite(wanted):
            now += min(max(wanted - now, -step), step)
        obeyed[cycle] = now
    return obeyed
