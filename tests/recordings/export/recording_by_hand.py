"""A small recording that holds every signal, and values that are hard to carry over."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle
from math import inf, nan
from pathlib import Path
from typing import Final

import recordings_by_hand
from msgspec.structs import asdict
from plans_by_hand import with_changes
from recordings_by_hand import numbered, whole_run, write_messages

from bus_schemas.bus import Delivery
from bus_schemas.messages import GivenUp, HelpGiven, Notice, Production, Setpoint, Telemetry
from bus_schemas.signals import GIVEN_UP, IMPP, NOTICE
from bus_schemas.tree import ROOT

PLAN: Final = with_changes(
    recordings_by_hand.PLAN, cycles=4, cycle_ns=500_000_000, cycle_wall_ns=500_000_000
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
    """A run in which no number is an easy one."""
    numbers, odd = cycle(HARD), cycle((nan, inf, -inf, 7.5))
    for port, message in whole_run(PLAN.timing.cycles):
        message.sim_time_ns = PLAN.timing.sim_time_ns(message.cycle)
        for field, value in asdict(message).items():
            if isinstance(value, float):
                setattr(message, field, next(numbers))
        if isinstance(message, Telemetry):
            message.power_kw = next(odd)
            message.available_kw = None if port.node == "c1/a" else next(numbers)
        if isinstance(message, Production):
            message.inverter_mpp_kw = (next(odd), next(numbers), 1.0, 2.0)
        if isinstance(message, Setpoint) and message.help_given:
            message.help_given = (HelpGiven("c1/a", next(odd)), HelpGiven("c2/c", next(numbers)))
        if port is IMPP.of("c1") and message.cycle:
            message.missing = ("c1/b/impp@0", "c1/b/residual")
        yield port, message
    notice = Notice(1, PLAN.timing.sim_time_ns(1), "c2", (), text=QUOTED, count=2**53 + 1)
    yield NOTICE.of("c2"), notice
    given_up = GivenUp(1, PLAN.timing.sim_time_ns(1), "plant", (), agents=("c1/a",))
    yield GIVEN_UP.of(ROOT), given_up
