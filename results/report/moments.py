"""The hardest minutes of a run, each with a small map of who lacked power and who gave it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from markupsafe import Markup

from agents.plan import RunPlan
from bus_schemas.tree import parent_of
from recordings.read.run_clock import RunClock
from results.highlights import HardMinute
from results.report import style

_WIDTH, _HEIGHT, _EDGE = 200.0, 130.0, 14.0
_LEAST_PX, _MOST_PX = 3.0, 12.0
_MOST_INVERTERS: Final = 1_000
"""In a larger plant a map would be one dark patch."""

_MAP: Final = Markup('<svg viewBox="0 0 {:g} {:g}" role="img" aria-label="map">{}</svg>')
_DOT: Final = Markup(
    '<circle cx="{:.1f}" cy="{:.1f}" r="{:.1f}" fill="{}"><title>{}</title></circle>'
)


class Moment(NamedTuple):
    """A minute of a run: when it was hardest, a sentence, two energies, a map."""

    time: str
    sentence: str
    energies: str
    drawing: Markup


def moments(minutes: Sequence[HardMinute], plan: RunPlan, clock: RunClock) -> Iterator[Moment]:
    """Yield the hard minutes of a run with their maps."""
    for one in minutes:
        energies = (
            f"missed {one.missed_kwh:,.2f} kWh in this minute; "
            f"without help {one.without_help_kwh:,.2f} kWh"
        )
        drawing = _drawing(one, _places(plan, one.noun))
        yield Moment(clock.text(one.cycle), one.sentence(), energies, drawing)


def _places(plan: RunPlan, noun: str) -> dict[str, tuple[float, float]]:
    """Return where inverters, or clusters, stand in a map; empty if that is not known."""
    leaves, positions = plan.tree.leaves, plan.site.positions_m
    if not 1 < len(leaves) <= _MOST_INVERTERS or len(positions) != len(leaves):
        return {}
    nodes = leaves if noun == "inverter" else tuple(dict.fromkeys(map(parent_of, leaves)))
    metres = np.array(
        [np.mean([positions[at] for at in plan.tree.leaves_below(node)], axis=0) for node in nodes]
    )
    low, span = metres.min(axis=0), np.maximum(np.ptp(metres, axis=0), 1.0)
    scale = min((_WIDTH - 2 * _EDGE) / span[0], (_HEIGHT - 2 * _EDGE) / span[1])
    east, north = ((metres - low) * scale).T.tolist()
    return {
        node: (_EDGE + x, _HEIGHT - _EDGE - y)
        for node, x, y in zip(nodes, east, north, strict=True)
    }


def _drawing(minute: HardMinute, places: dict[str, tuple[float, float]]) -> Markup:
    """Draw each node as a dot, larger the farther it was from its share."""
    if not places:
        return Markup("")
    sides = {node: (kw, style.VERMILLION) for node, kw in minute.lacking}
    sides |= {node: (kw, style.BLUE) for node, kw in minute.gave}
    largest = max((kw for kw, _ in sides.values()), default=1.0)
    dots = []
    for node, (x, y) in places.items():
        kw, colour = sides.get(node, (0.0, style.GREY))
        radius = _LEAST_PX + (_MOST_PX - _LEAST_PX) * (kw / largest) ** 0.5
        dots.append(_DOT.format(x, y, radius, colour, f"{node}: {kw:,.1f} kW off its share"))
    return _MAP.format(_WIDTH, _HEIGHT, Markup("").join(dots))
