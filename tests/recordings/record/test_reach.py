"""Whom the listeners do not hear, by what they state in `missing`."""

from __future__ import annotations

from typing import Any

from plans_by_hand import REAL_TIME, plan_of

from bus_schemas.codec import encode
from bus_schemas.messages import Head, Help, Impp, Memory, Message, Production, Setpoint
from bus_schemas.signals import HELP, IMPP, MEMORY, PRODUCTION, SETPOINT, Port
from bus_schemas.tree import PLANT, ROOT
from recordings.record.reach import Reach

A, B = "c1/a", "c1/b"


class Heard:
    """What a recorder heard of two inverters and their supervisor, cycle by cycle."""

    def __init__(self, **changes: tuple[str, ...]) -> None:
        plan = plan_of({A: 100.0, B: 100.0}, cycle_wall_ns=REAL_TIME, **changes)
        self.reach = Reach(plan, 0)
        self.now_ns = 0

    def hear(self, cycle: int, port: Port[Message], *missing: str) -> None:
        self.now_ns = cycle * REAL_TIME
        source, head = port.publisher, (cycle, 0)
        message: Message
        if port.signal is HELP:
            message = Help(*head, source, missing, missing_kw=1.0)
        elif port.signal is SETPOINT:
            message = Setpoint(*head, source, missing, power_kw=50.0, share_kw=50.0, help_given=())
        elif port.signal is MEMORY:
            nothing: dict[str, Any] = {"expected_kw": (), "reference_kw": None}
            message = Memory(*head, source, missing, correction_kw=0.0, error_kw=0.0, **nothing)
        elif port.signal is IMPP:
            message = Impp(*head, source, missing, power_kw=50.0, stale_cycles=0)
        else:
            powers: dict[str, Any] = dict.fromkeys(("dispatch_kw", "available_kw"), 0.0)
            powers |= dict.fromkeys(("inverter_mpp_kw", "inverter_power_kw"), (0.0, 0.0))
            message = Production(*head, source, missing, delivered_kw=0.0, **powers)
        self.reach.hear(port, Head(cycle, source), encode(message), self.now_ns)

    @property
    def not_heard(self) -> list[str]:
        return self.reach.not_heard(self.now_ns)


def test_a_process_is_not_heard_if_every_listener_lacks_it() -> None:
    run = Heard()
    for cycle in (5, 6):
        run.hear(cycle, PRODUCTION.of(ROOT), f"{A}/command@1")
        run.hear(cycle, IMPP.of("c1"))
        assert run.not_heard == [], "its supervisor hears it"
        run.hear(cycle, IMPP.of("c1"), f"{A}/impp", f"{A}/residual@2")
    assert run.not_heard == [A]
    run.hear(7, PRODUCTION.of(ROOT))
    assert run.not_heard == []


def test_a_controller_that_waits_for_the_dispatch_of_a_plant_that_is_cut_off_is_not_blamed() -> (
    None
):
    run = Heard()
    commands = [f"{leaf}/command" for leaf in (A, B)]
    for cycle in range(5, 30):
        run.hear(cycle, IMPP.of(ROOT), "dispatch")
        run.hear(cycle, MEMORY.of(ROOT), "dispatch")
        if cycle < 12:  # Until the dispatch has expired.
            run.hear(cycle, SETPOINT.of("c1"), "dispatch")
        run.hear(cycle, IMPP.of("c1"), "dispatch")
        if cycle < 20:  # Until the setpoint has expired too.
            late = ("c1/setpoint@11",) if cycle >= 12 else ()
            run.hear(cycle, SETPOINT.of(A), "dispatch", *late)
        run.hear(cycle, PRODUCTION.of(ROOT), *commands, "memory")
        assert "central" not in run.not_heard, cycle


def test_a_plant_that_awaits_one_process_alone_is_believed() -> None:
    run = Heard(groups=("central",))
    for cycle in range(5, 10):
        run.hear(cycle, MEMORY.of(ROOT))
        run.hear(cycle, PRODUCTION.of(ROOT), f"{A}/command", f"{B}/command", "memory")
    assert run.not_heard == ["central"]


def test_telemetry_that_the_plant_withholds_of_one_inverter_blames_nobody() -> None:
    run = Heard()
    for cycle in range(60):
        run.hear(cycle, IMPP.of(A), f"{A}/telemetry")
        run.hear(cycle, IMPP.of(B))
    assert run.not_heard == []


def test_the_order_in_which_messages_come_does_not_matter() -> None:
    run = Heard()
    run.hear(9, PRODUCTION.of(ROOT))
    run.hear(9, IMPP.of("c1"))
    for cycle in (5, 6, 7, 8):
        run.hear(cycle, IMPP.of("c1"), f"{A}/impp", f"{A}/residual")
        run.hear(cycle, PRODUCTION.of(ROOT), f"{A}/command")
    assert run.not_heard == []


def test_a_recorder_that_hears_nobody_proves_nothing() -> None:
    run = Heard()
    run.hear(5, PRODUCTION.of(ROOT), f"{A}/command")
    run.hear(5, IMPP.of("c1"), f"{A}/impp", f"{A}/residual")
    assert run.not_heard == [A]
    for _ in range(20):
        run.now_ns += REAL_TIME // 4
        silent = run.reach.not_recorded(run.now_ns)
    assert {PLANT, A, B} <= set(silent)
    assert run.not_heard == []


def test_a_recorder_that_stood_still_itself_has_lost_nobody() -> None:
    run = Heard()
    run.hear(5, PRODUCTION.of(ROOT))
    assert run.reach.not_recorded(run.now_ns + 60 * REAL_TIME) == []


def test_statements_of_a_device_prove_nothing() -> None:
    run = Heard(external=("c1",))
    run.hear(9, IMPP.of("c1"), f"{A}/impp", f"{A}/residual")
    assert run.not_heard == []
