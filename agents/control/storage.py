"""What storages can do, and what they are asked for.

A storage has no share of the dispatch. It gives what the inverters lack and takes what they give
too much; it is charged from headroom alone. No inverter is asked for less because there is one.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Final, NamedTuple

from agents.control.allocation import total

if TYPE_CHECKING:
    from agents.control.allocation import Numbers

CHARGED_SHARE: Final = 0.5
"""Share of the inverters' headroom that storages are charged with: a forecast may be too high."""

KEPT_ERRORS: Final = 8.0
"""Mean errors of the plant's power that do not count as headroom: under a wild sky the power that
a storage takes would soon be missing."""


class StorageLaw(NamedTuple):
    """A storage in numbers, in cycles of a length.

    ramp_kw: Largest change of its power in a cycle [kW].
    lowest_kwh, highest_kwh, target_kwh: Between which energies it works, and what it returns to.
    charge_efficiency, discharge_efficiency: From the bus bar into the store, and back.
    loss_kw: What the store loses all the time.
    """

    rating_kw: float
    ramp_kw: float
    lowest_kwh: float
    highest_kwh: float
    target_kwh: float
    charge_efficiency: float
    discharge_efficiency: float
    loss_kw: float
    cycle_h: float


class Ability(NamedTuple):
    """What storages can give and take through the coming cycle [kW].

    charge_kw: The power, of what they can take, that brings them back to their targets.
    """

    discharge_kw: float = 0.0
    absorb_kw: float = 0.0
    charge_kw: float = 0.0


NO_ABILITY: Final = Ability()


def ability(energy_kwh: float, power_kw: float, law: StorageLaw) -> Ability:
    """Return what a storage can do that holds this energy and gave this power last."""
    into_kw_per_kwh = 1.0 / (law.charge_efficiency * law.cycle_h)
    stored_kw = max(energy_kwh - law.lowest_kwh, 0.0) * law.discharge_efficiency / law.cycle_h
    room_kw = max(law.highest_kwh - energy_kwh, 0.0) * into_kw_per_kwh
    lacking_kw = max(law.target_kwh - energy_kwh, 0.0) * into_kw_per_kwh
    discharge_kw = max(min(law.rating_kw, stored_kw, power_kw + law.ramp_kw), 0.0)
    absorb_kw = max(min(law.rating_kw, room_kw, law.ramp_kw - power_kw), 0.0)
    return Ability(discharge_kw, absorb_kw, min(absorb_kw, lacking_kw))


def moved(
    energy_kwh: float, last_kw: float, wanted_kw: float, law: StorageLaw
) -> tuple[float, float]:
    """Return the power that a storage gives in a cycle, and the energy in it at the end.

    It goes to the wanted power as fast as it can, and never beyond its limits.
    """
    energy_kwh -= min(law.loss_kw * law.cycle_h, energy_kwh)
    power_kw = min(max(wanted_kw, last_kw - law.ramp_kw), last_kw + law.ramp_kw)
    power_kw = min(max(power_kw, -law.rating_kw), law.rating_kw)
    if power_kw >= 0.0:
        stored_kwh = max(energy_kwh - law.lowest_kwh, 0.0)
        power_kw = min(power_kw, stored_kwh * law.discharge_efficiency / law.cycle_h)
        energy_kwh -= power_kw * law.cycle_h / law.discharge_efficiency
    else:
        room_kwh = max(law.highest_kwh - energy_kwh, 0.0)
        power_kw = max(power_kw, -room_kwh / (law.charge_efficiency * law.cycle_h))
        energy_kwh -= power_kw * law.cycle_h * law.charge_efficiency
    return power_kw, energy_kwh


class Pursuit(NamedTuple):
    """How the inverters together follow what they are asked for, as their parent expects it.

    delay: Turns until a command takes effect.
    ramp_kw: Largest change of their power in a turn [kW].
    """

    delay: int
    ramp_kw: float


AT_ONCE: Final = Pursuit(0, inf)


class Course(NamedTuple):
    """What the inverters were asked for in the last turns, the newest first, and should give now.

    NaN stands in turns before the first.
    """

    asked_kw: tuple[float, ...]
    coming_kw: float


def asked_kw(target_kw: float, impp_kw: float, error_kw: float, able: Ability) -> float:
    """Return what the inverters are asked for: the target, and what charges the storages.

    `error_kw` is the mean error of the plant's power.
    """
    headroom_kw = max(impp_kw - target_kw - KEPT_ERRORS * error_kw, 0.0)
    return target_kw + min(able.charge_kw, CHARGED_SHARE * headroom_kw)


def next_course(last: Course, asked_kw: float, impp_kw: float, pursuit: Pursuit) -> Course:
    """Go on a turn in which the inverters are asked for a power and could give `impp_kw`."""
    asked = (asked_kw, *last.asked_kw[:-1])
    wanted_kw = asked[pursuit.delay]
    if not wanted_kw >= 0.0:  # NaN: nobody knows what they obey.
        wanted_kw = asked_kw
    coming_kw = wanted_kw
    if last.coming_kw >= 0.0:
        coming_kw = min(
            max(wanted_kw, last.coming_kw - pursuit.ramp_kw), last.coming_kw + pursuit.ramp_kw
        )
    return Course(asked, min(coming_kw, impp_kw))


def storage_kw(
    target_kw: float, impp_kw: float, coming_kw: float, able: Ability, helps_first: bool
) -> float:
    """Return what storages are to give together in a turn; below 0 they take it [kW].

    Parameters
    ----------
    target_kw
        What inverters and storages are to give together.
    impp_kw, coming_kw
        What the inverters could give, and what they are expected to.
    able
        What the storages can do.
    helps_first
        Whether they also give what inverters could, until those do.
    """
    if coming_kw > target_kw:
        return -min(coming_kw - target_kw, able.absorb_kw)
    lacking_kw = target_kw - (coming_kw if helps_first else impp_kw)
    return min(max(lacking_kw, 0.0), able.discharge_kw)


def parts_kw(power_kw: float, discharge_kw: Numbers, absorb_kw: Numbers) -> list[float]:
    """Divide a power among storages by what each can give, or take; none gets more than that."""
    able_kw = discharge_kw if power_kw >= 0.0 else absorb_kw
    sum_kw = total(able_kw)
    share = min(max(power_kw / sum_kw, -1.0), 1.0) if sum_kw > 0.0 else 0.0
    return [share * kw for kw in able_kw]
