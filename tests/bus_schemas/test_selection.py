"""Names of nodes that a user gives, and the nodes and agents that they mean."""

from __future__ import annotations

import pytest

from bus_schemas.selection import find_agents, find_nodes
from bus_schemas.tree import ControlTree

TREE = ControlTree((("c1/a", 1.0), ("c1/b", 1.0), ("c10/a", 1.0)))


@pytest.mark.parametrize(
    ("names", "found"),
    [
        ("c1", {"c1"}),
        ("c1/*", {"c1", "c1/a", "c1/b"}),
        ("*", {"", "c1", "c1/a", "c1/b", "c10", "c10/a"}),
        (["c1/a", "c1/*"], {"c1", "c1/a", "c1/b"}),
        ("central", {""}),
        ("central/*", {"", "c1", "c1/a", "c1/b", "c10", "c10/a"}),
        ("c1/a, c10/*", {"c1/a", "c10", "c10/a"}),
        (["", "c10"], {"", "c10"}),
        ((), set()),
    ],
)
def test_a_star_means_a_node_and_all_below_it(names: str | list[str], found: set[str]) -> None:
    nodes = find_nodes(TREE, names)
    assert set(nodes) == found
    assert len(nodes) == len(found), "each once"


def test_agents_are_the_nodes_and_the_plant() -> None:
    assert find_agents(TREE, "plant,central,c10/*") == ("plant", "central", "c10", "c10/a")
