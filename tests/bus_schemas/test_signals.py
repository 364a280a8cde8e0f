"""The one table of signals: who publishes, who listens, and what the keys are."""

from __future__ import annotations

import pytest
import zenoh

from bus_schemas.signals import ORDER, listeners
from bus_schemas.tree import OPERATOR, ROOT, ControlTree
from bus_schemas.wiring import Wiring

OAHU = ControlTree((("c1/inv07", 470.0), ("c1/inv08", 470.0), ("c2/inv09", 470.0)))
RAGGED = ControlTree((("inv01", 1.0), ("c1/inv02", 1.0), ("z1/c1/inv03", 1.0)))
FLAT = ControlTree((("inv01", 1.0),))
TREES = [OAHU, RAGGED, FLAT]

WIRING = Wiring("oahu", OAHU)
LEAVES = ("c1/inv07", "c1/inv08", "c2/inv09")


@pytest.mark.parametrize(
    ("key", "published_by", "heard_by"),
    [
        ("oahu/c1/inv07/telemetry", "plant", ("c1/inv07",)),
        ("oahu/dispatch", "plant", ("central", "c1", "c2", *LEAVES)),
        ("oahu/meter", "plant", ("central",)),
        ("oahu/c1/inv07/impp", "c1/inv07", ("c1",)),
        ("oahu/impp", "central", ()),
        ("oahu/c1/setpoint", "central", ("c1",)),
        ("oahu/c1/inv07/command", "c1/inv07", ("plant",)),
        ("oahu/ready", "recorder", ("plant",)),
        ("oahu/clock", "replayer", ()),
    ],
)
def test_publishers_and_listeners_of_a_key(
    key: str, published_by: str, heard_by: tuple[str, ...]
) -> None:
    port = WIRING.port(key)
    assert port is not None
    assert WIRING.key(port) == key
    assert port.publisher == published_by
    assert listeners(port, OAHU) == heard_by


@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("has_operator", [False, True])
def test_listeners_are_others_of_the_run_linked_and_wired_with_whom_they_hear(
    tree: ControlTree, has_operator: bool
) -> None:
    wiring = Wiring("oahu", tree, devices=(OPERATOR,) * has_operator)
    agents = {*tree.agents(), *({OPERATOR} if has_operator else ())}
    linked = {frozenset(pair) for pair in wiring.links().pairs}
    assert (ORDER.of(ROOT) in wiring.ports) == has_operator
    for port in wiring.ports:
        heard_by = listeners(port, tree, has_operator=has_operator)
        assert len(set(heard_by)) == len(heard_by)
        assert set(heard_by) <= agents - {port.publisher}
        assert {frozenset({port.publisher, listener}) for listener in heard_by} <= linked
        assert wiring.listeners[port] == heard_by
        for agent in agents:
            assert (port in wiring.heard[agent]) == (agent in heard_by)


# Several agents in one process -------------------------------------------------------------------

PLACES = [f"z{z}/c{z}{c}/i{leaf}" for z in (1, 2) for c in (1, 2, 3) for leaf in (1, 2, 3)]
TALL = ControlTree(tuple((path, 1.0) for path in (*PLACES, "z1/i9", "c9/i1", "c9-x/i1")))


@pytest.mark.parametrize("groups", [{}, "c", "z", dict.fromkeys(TALL.nodes, "central")])
def test_a_process_may_publish_what_its_agents_may_and_nothing_else(groups: object) -> None:
    if isinstance(groups, str):
        heads = [path for path in TALL.parents if path.rpartition("/")[2].startswith(groups)]
        groups = {
            node: head for head in heads for node in TALL.nodes if f"{node}/".startswith(f"{head}/")
        }
    assert isinstance(groups, dict)
    wiring = Wiring("tall", TALL, groups)
    keys = {wiring.key(port): port for port in wiring.ports}
    for (source, sink), carried in wiring.carried.items():
        allowed = [zenoh.KeyExpr(expr) for expr in wiring.key_exprs(carried)]
        through = {
            port
            for key, port in keys.items()
            if any(one.includes(zenoh.KeyExpr(key)) for one in allowed)
        }
        assert through == {*carried}, (source, sink)
        assert {wiring.process_of(port.publisher) for port in carried} == {source}
        if sink != "recorder":
            hearers = {
                wiring.process_of(name) for port in carried for name in wiring.listeners[port]
            }
            assert sink in hearers


@pytest.mark.parametrize("devices", [(), ("plant",), ("z1/c11/i2",)])
def test_a_bundle_holds_what_a_group_says_to_itself_or_exchanges_with_a_plant_of_ours(
    devices: tuple[str, ...],
) -> None:
    groups = {node: "z1" for node in TALL.nodes if node.startswith("z1") and node not in devices}
    wiring = Wiring("tall", TALL, groups, devices=devices)
    bundles = {bundle.key: bundle for bundle in wiring.bundles}
    with_plant = {"z1/telemetry_bundle", "z1/command_bundle"} if "plant" not in devices else set()
    assert bundles.keys() == {"z1/bundle", *with_plant}
    held = [port for bundle in bundles.values() for port in bundle.ports.values()]
    assert len(held) == len({*held})
    for port in wiring.ports:
        ends = {port.publisher, *wiring.listeners[port]}
        inside = {wiring.process_of(end) for end in ends} == {"z1"}
        beyond = with_plant and len(ends) == 2 and ends - {*groups} == {"plant"}
        is_held = port.signal.is_cyclic and (inside or beyond)
        assert (port in held) == bool(is_held), port
