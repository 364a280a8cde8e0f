"""The one table of signals: who publishes, who listens, and what the keys are."""

from __future__ import annotations

import pytest

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
def test_who_speaks_and_who_listens(key: str, published_by: str, heard_by: tuple[str, ...]) -> None:
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
    wiring = Wiring("oahu", tree, has_operator=has_operator)
    agents = {*tree.agents(), *({OPERATOR} if has_operator else ())}
    linked = {frozenset(pair) for pair in wiring.links().pairs}
    assert (ORDER.of(ROOT) in wiring.ports) == has_operator
    for port in wiring.ports:
        heard_by = listeners(port, tree, has_operator=has_operator)
        assert len(set(heard_by)) == len(heard_by)
        assert set(heard_by) <= agents - {port.publisher}
        assert {frozenset({port.publisher, listener}) for listener in heard_by} <= linked
        assert port in wiring.published[port.publisher]
        assert wiring.listeners[port] == heard_by
        for agent in agents:
            assert (port in wiring.heard.get(agent, ())) == (agent in heard_by)
