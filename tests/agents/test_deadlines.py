"""When each stage of a cycle must close at the latest, in real time."""

from __future__ import annotations

import pytest

from agents.deadlines import USED_SHARE, deadline_ns, stage_place
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
    found = deadline_ns(agent, stage, THREE_LAYERS, cycle_wall_ns=800_000_000)
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


@pytest.mark.parametrize("tree", [FLAT, THREE_LAYERS, RAGGED])
def test_whoever_listens_waits_longer_than_whoever_speaks(tree: ControlTree) -> None:
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
            compared += 1
    assert compared > len(tree.nodes)


@pytest.mark.parametrize("tree", [FLAT, THREE_LAYERS, RAGGED])
def test_the_plant_has_its_margin_before_the_next_tick(tree: ControlTree) -> None:
    assert deadline_ns("plant", "advance", tree, 1_000_000_000) == USED_SHARE * 1_000_000_000
