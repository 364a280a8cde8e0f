"""When each stage of a cycle must close at the latest, in real time."""

from __future__ import annotations

import pytest

from agents.deadlines import USED_SHARE, Deadlines, stage_place
from bus_schemas.signals import SIGNALS, listeners, ports
from bus_schemas.tree import ControlTree

THREE_LAYERS = ControlTree((("c1/a", 100.0), ("c1/b", 100.0), ("c2/a", 100.0)))
RAGGED = ControlTree((("a", 1.0), ("c1/b", 1.0), ("z1/c1/d", 1.0), ("z1/y1/x1/e", 1.0)))
FLAT = ControlTree((("a", 1.0), ("b", 1.0)))


@pytest.mark.parametrize(
    ("agent", "stage", "expected_ms"),
    [
        ("plant", "begin", 0),
        ("central", "request", 90),
        ("c1", "request", 180),
        ("c1/a", "estimate", 270),
        ("c1", "report", 360),
        ("central", "solve", 450),
        ("c1", "solve", 540),
        ("c1/a", "actuate", 630),
        ("plant", "advance", 720),
    ],
)
def test_the_stages_of_three_layers_share_nine_tenths_of_the_cycle(
    agent: str, stage: str, expected_ms: int
) -> None:
    # 90 % of 800 ms are 720 ms for eight steps from the plant to the plant.
    found = Deadlines(THREE_LAYERS, 800_000_000).deadline_ns(agent, stage)
    assert found == expected_ms * 1_000_000


def stage_that_says(signal: str, agent: str) -> str:
    if agent == "plant":
        return "advance" if signal == "production" else "begin"
    layer = "central" if agent == "central" else "middle"
    return {
        ("request", "central"): "request",
        ("request", "middle"): "request",
        ("setpoint", "central"): "solve",
        ("setpoint", "middle"): "solve",
    }[signal, layer]


def stage_that_reports(tree: ControlTree, agent: str) -> str:
    if agent == "central":
        return "solve"
    return "estimate" if tree.is_leaf(agent) else "report"


def stage_that_hears(tree: ControlTree, signal: str, agent: str) -> str:
    if agent == "plant":
        return "advance"
    if signal in {"impp", "residual", "help"}:
        return stage_that_reports(tree, agent)
    if signal == "setpoint":
        return "actuate" if tree.is_leaf(agent) else "solve"
    if signal == "dispatch":
        return "request"
    return "estimate" if tree.is_leaf(agent) else "request"


@pytest.mark.parametrize(
    ("agent", "stage", "expected_ms"),
    [
        ("plant", "begin", 0),
        ("central", "request", 80),
        ("c1", "request", 160),
        ("c1/a", "estimate", 240),
        ("c1", "report", 320),
        ("central", "solve", 400),
        ("c1", "solve", 500),
        ("c1/a", "actuate", 550),
        ("plant", "advance", 775),
    ],
)
def test_a_tiers_deadline_is_that_of_its_last_word(
    agent: str, stage: str, expected_ms: int
) -> None:
    # Up to the central controller's 400 ms there are five steps; the plant waits half the rest.
    tiers_ns = (400_000_000, 500_000_000, 550_000_000)
    found = Deadlines(THREE_LAYERS, 1_000_000_000, tiers_ns).deadline_ns(agent, stage)
    assert found == expected_ms * 1_000_000


def test_a_direct_controller_has_the_deadline_of_its_like_from_whatever_tier_it_hangs() -> None:
    tiers_ns = (10_000, 20_000, 30_000, 40_000, 50_000)
    deadlines = Deadlines(RAGGED, 60_000, tiers_ns)
    found = {
        agent: deadlines.deadline_ns(agent, "actuate")
        for agent in ("a", "c1/b", "z1/c1/d", "z1/y1/x1/e")
    }
    assert set(found.values()) == {50_000}
    assert deadlines.deadline_ns("z1/y1", "solve") == 30_000


@pytest.mark.parametrize(
    ("agent", "stage", "even_ms", "by_tier_ms"),
    [
        ("plant", "begin", 90, 1),  # as much as the stage after it
        ("central", "request", 90, 1),
        ("c1", "report", 90, 1),
        ("central", "solve", 90, 1),
        ("c1", "solve", 90, 495),
        ("c1/a", "actuate", 90, 50),
        ("plant", "advance", 90, 125),
    ],
)
def test_a_stages_slice_lies_between_the_deadline_before_it_and_its_own(
    agent: str, stage: str, even_ms: int, by_tier_ms: int
) -> None:
    assert Deadlines(THREE_LAYERS, 800_000_000).slice_ns(agent, stage) == even_ms * 1_000_000
    tiers_ns = (5_000_000, 500_000_000, 550_000_000)
    found = Deadlines(THREE_LAYERS, 800_000_000, tiers_ns).slice_ns(agent, stage)
    assert found == by_tier_ms * 1_000_000


def test_a_direct_controllers_slice_begins_at_the_deadline_of_its_own_parent() -> None:
    tiers_ns = (10_000, 20_000, 30_000, 40_000, 50_000)
    found = [
        Deadlines(RAGGED, 60_000, tiers_ns).slice_ns(agent, "actuate")
        for agent in ("a", "c1/b", "z1/c1/d", "z1/y1/x1/e")
    ]
    assert found == [40_000, 30_000, 20_000, 10_000]


def evenly(tree: ControlTree) -> tuple[int, ...]:
    """Deadlines of the tiers that follow closely upon each other late in the cycle."""
    return tuple(800_000_000 + 10_000_000 * tier for tier in range(tree.height + 1))


@pytest.mark.parametrize("tree", [FLAT, THREE_LAYERS, RAGGED])
@pytest.mark.parametrize("by_tier", [False, True])
def test_whoever_listens_waits_longer_than_whoever_speaks(tree: ControlTree, by_tier: bool) -> None:
    deadlines = Deadlines(tree, 1_000_000_000, evenly(tree) if by_tier else ())
    of_the_loop = {signal for signal in SIGNALS if signal.name not in {"run", "ready", "notice"}}
    compared = 0
    for port in ports(tree):
        name = port.signal.name
        if port.signal not in of_the_loop:
            continue
        for listener in listeners(port, tree):
            speaker = port.publisher
            if name in {"impp", "residual", "help"}:
                said = stage_that_reports(tree, speaker)
            elif name == "command":
                said = "actuate"
            else:
                said = stage_that_says(name, speaker)
            heard = stage_that_hears(tree, name, listener)
            assert stage_place(speaker, said, tree) < stage_place(listener, heard, tree), port
            said_ns = deadlines.deadline_ns(speaker, said)
            heard_ns = deadlines.deadline_ns(listener, heard)
            assert said_ns < heard_ns < 1_000_000_000, port
            compared += 1
    assert compared > len(tree.nodes)


@pytest.mark.parametrize("tree", [FLAT, THREE_LAYERS, RAGGED])
def test_the_plant_has_its_margin_before_the_next_tick(tree: ControlTree) -> None:
    assert (
        Deadlines(tree, 1_000_000_000).deadline_ns("plant", "advance") == USED_SHARE * 1_000_000_000
    )
