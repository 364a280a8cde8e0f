"""A small recording that holds every signal, and values that are hard to carry over."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, nan
from pathlib import Path
from typing import Final

from recorded_runs import plan_of
from recordings_by_hand import numbered, write_messages

from bus_schemas import messages, signals
from bus_schemas.bus import Delivery
from bus_schemas.messages import HelpGiven
from bus_schemas.tree import ROOT

PLAN: Final = plan_of(
    {"c1/a": 100.0, "c1/b": 100.0, "c2/c": 100.0},
    cycles=4,
    cycle_ns=500_000_000,
    cycle_wall_ns=500_000_000,
    scheme="paper",
    correction=False,
)

HARD: Final = (0.1 + 0.2, 100 / 3, 5e-324, 1.7976931348623157e308, -0.0, 1e-7, 123456789.123456789)
"""Numbers that lose their last bits, or their sign, where not all digits are kept."""

QUOTED: Final = 'refused "null", ten\ntimes; Wörter, NaN'

RECORDER_LAG_NS: Final = 1_234


def written(path: Path) -> list[Delivery]:
    """Write the recording; return what is in it."""
    deliveries = [*numbered(_said())]
    for _, message in deliveries:
        message.ready_time_ns = message.publish_time_ns - 1_000
    logged = ((port, m, m.publish_time_ns + RECORDER_LAG_NS) for port, m in deliveries)
    write_messages(path, logged, plan=PLAN, scenario='title = "by hand"\n', driver="launch")
    return deliveries


def _said() -> Iterator[Delivery]:
    yield signals.RUN.of(ROOT), PLAN.run_message("start", 0, 17)
    for cycle in range(PLAN.cycles):
        yield from _of_the_plant(cycle)
        yield from _of_the_tree(cycle)
    yield signals.RUN.of(ROOT), PLAN.run_message("stop", PLAN.cycles, 17)


def _of_the_plant(cycle: int) -> Iterator[Delivery]:
    stamp = (cycle, PLAN.sim_time_ns(cycle), "plant", ())
    hard = HARD[cycle % len(HARD)]
    for place, leaf in enumerate(PLAN.tree.leaves):
        power_kw = (nan, inf, -inf, hard)[(cycle + place) % 4]
        yield (
            signals.TELEMETRY.of(leaf),
            messages.Telemetry(
                *stamp,
                power_kw=power_kw,
                alpha=1.0,
                limit_kw=hard,
                available_kw=None if place == 0 else hard,
            ),
        )
    yield (
        signals.DISPATCH.of(ROOT),
        messages.Dispatch(
            *stamp, power_kw=hard, plant_rating_kw=300.0, commitment_kw=200.0, regulation_kw=-0.0
        ),
    )
    yield signals.METER.of(ROOT), messages.Meter(*stamp, power_kw=hard)
    yield (
        signals.PRODUCTION.of(ROOT),
        messages.Production(
            *stamp,
            desired_kw=hard,
            possible_kw=1.0,
            delivered_kw=HARD[-1],
            inverter_mpp_kw=(hard, 1.0, nan if cycle == 2 else 2.0),
            inverter_power_kw=(3.0, hard, 4.0),
        ),
    )


def _of_the_tree(cycle: int) -> Iterator[Delivery]:
    time_ns = PLAN.sim_time_ns(cycle)
    hard = HARD[(cycle + 3) % len(HARD)]
    for node in PLAN.tree.nodes:
        missing = ("c1/b/impp@0", "c1/b/residual") if node == "c1" and cycle else ()
        stamp = (cycle, time_ns, node or "central", missing)
        yield signals.IMPP.of(node), messages.Impp(*stamp, power_kw=hard, stale_cycles=cycle)
        yield signals.RESIDUAL.of(node), messages.Residual(*stamp, power_kw=-hard)
    yield signals.HELP.of(ROOT), messages.Help(cycle, time_ns, "central", (), missing_kw=hard)
    given = (HelpGiven("c1/b", hard), HelpGiven("c2/c", nan if cycle == 3 else 1.5))
    for node, lines in (("c1", ()), ("c1/a", given[: cycle + 1]), ("c1/b", ())):
        parent = node.rpartition("/")[0] or "central"
        yield (
            signals.SETPOINT.of(node),
            messages.Setpoint(
                cycle, time_ns, parent, (), power_kw=hard, share_kw=9.5, help_given=lines
            ),
        )
    for leaf in PLAN.tree.leaves:
        yield (
            signals.COMMAND.of(leaf),
            messages.Command(cycle, time_ns, leaf, (), alpha=0.5, power_kw=hard),
        )
    if cycle == 1:
        yield (
            signals.NOTICE.of("c2"),
            messages.Notice(cycle, time_ns, "c2", (), text=QUOTED, count=2**53 + 1),
        )
