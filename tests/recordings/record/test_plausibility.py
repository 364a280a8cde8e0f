"""Numbers that cannot be right are named; everything that the plant and its controllers say is."""

from __future__ import annotations

from math import inf, nan

import pytest
from msgspec.structs import replace
from plans_by_hand import with_changes
from recorded_runs import cloudy_profile, plan_of, published

from bus_schemas.signals import RUN
from bus_schemas.tree import ROOT
from recordings.record.plausibility import out_of_range

PLAN = plan_of(cycles=60)
REAL_TIME = with_changes(PLAN, cycle_wall_ns=1_000_000_000)
HEARD_NS = 77_000_000_000
SAID = published(PLAN, cloudy_profile(PLAN))
BY_DEPTH = sorted(SAID, key=lambda pair: pair[0].node.count("/"))
GOOD = {port.signal.name: (port, message) for port, message in BY_DEPTH}
"""A message of each signal with its port: of an inverter where it is of nodes."""


def test_no_number_of_a_run_is_out_of_range() -> None:
    found = [out_of_range(PLAN, port, message, HEARD_NS) for port, message in SAID]
    assert len(found) > 2000
    assert not any(found)


POWERS = [
    *(("impp", "power_kw"), ("residual", "power_kw"), ("help", "missing_kw")),
    *(("setpoint", "power_kw"), ("command", "power_kw"), ("telemetry", "power_kw")),
]


@pytest.mark.parametrize(
    ("signal", "field", "value"),
    [
        *((*power, kw) for power in POWERS for kw in (nan, inf, -inf, -1e3, 1e3)),
        *((*power, -1.0) for power in POWERS if power[0] != "residual"),
        *(("command", "alpha", alpha) for alpha in (nan, 0.0, -0.1, 1.01)),
        *(
            ("dispatch", field, value)
            for field in ("power_kw", "commitment_kw", "regulation_kw")
            for value in (nan, inf, -inf)
        ),
        *(("production", "inverter_mpp_kw", (1.0,) * entries) for entries in (3, 0)),
        ("production", "available_kw", nan),
    ],
)
def test_a_number_that_cannot_be_right_is_named(signal: str, field: str, value: object) -> None:
    port, message = GOOD[signal]
    found = out_of_range(PLAN, port, replace(message, **{field: value}), HEARD_NS)
    assert found.startswith(field)
    assert ": expected " in found


def test_a_dispatch_beyond_the_ratings_is_acted_on_and_so_not_out_of_range() -> None:
    port, dispatch = GOOD["dispatch"]
    for power_kw in (-2000.0, 1e9):
        assert out_of_range(PLAN, port, replace(dispatch, power_kw=power_kw), HEARD_NS) == ""


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({}, ""),
        ({"start_time_ns": HEARD_NS - 9_000_000_000}, ""),
        ({"sim_time_ns": 7}, "sim_time_ns"),
        ({"start_time_ns": 0}, "start_time_ns"),
        ({"start_time_ns": HEARD_NS + 11_000_000_000}, "start_time_ns"),
        ({"cycle_wall_ns": 0}, "cycle_wall_ns"),
        ({"cycle": 3, "sim_time_ns": PLAN.timing.sim_time_ns(3)}, "cycle"),
    ],
)
def test_a_run_with_an_impossible_start_is_named(changes: dict[str, object], field: str) -> None:
    start = replace(REAL_TIME.run_message("start", 0, HEARD_NS), **changes)
    assert out_of_range(REAL_TIME, RUN.of(ROOT), start, HEARD_NS).partition(":")[0] == field
