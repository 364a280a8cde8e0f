"""Which arming round the recorder takes for the one under way."""

from __future__ import annotations

from bus_schemas.signals import DISPATCH, IMPP, Occurrence, ports
from bus_schemas.tree import PLANT, ROOT
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from recordings.record.recorder import Round

PLAN = prepare(load_scenario("oahu"), RunOptions(duration="10"), "run-1").plan
STEADY = [
    port
    for port in ports(PLAN.tree)
    if port.signal.occurrence in {Occurrence.CYCLE, Occurrence.TURN}
]
OF_PLANT = [port for port in STEADY if port.publisher == PLANT]
OF_OTHERS = [port for port in STEADY if port.publisher != PLANT]


def test_a_device_that_speaks_of_another_round_does_not_end_the_one_under_way() -> None:
    under_way = Round(PLAN)
    under_way.sees(DISPATCH.of(ROOT), -7)
    for early in (-5, -9, -6):
        assert not under_way.sees(IMPP.of("c2/inv07"), early)
    seen = [under_way.sees(port, -7) for port in (*OF_PLANT, *OF_OTHERS)]
    assert seen == [False] * (len(STEADY) - 1) + [True]
    assert under_way.answered
    assert under_way.count == 1


def test_answers_that_overtake_the_plants_words_are_counted() -> None:
    under_way = Round(PLAN)
    assert not any(under_way.sees(port, -7) for port in OF_OTHERS)
    assert under_way.unheard(["c2/inv07"]) == []
    seen = [under_way.sees(port, -7) for port in OF_PLANT]
    assert seen == [False] * (len(OF_PLANT) - 1) + [True]


def test_who_says_nothing_in_the_round_under_way_is_named() -> None:
    under_way = Round(PLAN)
    under_way.sees(DISPATCH.of(ROOT), -7)
    under_way.sees(IMPP.of("c2/inv07"), -5)
    assert under_way.unheard(["c2/inv07"]) == [
        f"c2/inv07/{signal}" for signal in ("command", "impp", "residual")
    ]
