"""The control tree: who is whose parent, which trees are refused, and the names of its nodes."""

from __future__ import annotations

import math

import pytest

from bus_schemas.errors import InputError
from bus_schemas.selection import find_nodes
from bus_schemas.tree import (
    LONGEST_PATH,
    MOST_CHILDREN,
    MOST_INVERTERS,
    ROOT,
    ControlTree,
)

TREE = ControlTree(
    (("c2/a", 100.0), ("c1/a", 250.0), ("e", 30.0), ("z1/c1/d", 70.0), ("c1/b", 20.0))
)


@pytest.mark.parametrize(
    ("node", "children", "rating_kw", "places"),
    [
        (ROOT, ("c2", "c1", "e", "z1"), 470.0, (0, 1, 2, 3, 4)),
        ("c1", ("c1/a", "c1/b"), 270.0, (1, 4)),
        ("z1", ("z1/c1",), 70.0, (3,)),
        ("e", (), 30.0, (2,)),
    ],
)
def test_a_node_has_the_children_of_the_next_tier_and_the_rating_of_all_its_inverters(
    node: str, children: tuple[str, ...], rating_kw: float, places: tuple[int, ...]
) -> None:
    assert TREE.children(node) == children
    assert TREE.rating_kw(node) == rating_kw
    assert TREE.leaves_below(node) == places, "in the order of the plant"


@pytest.mark.parametrize(
    ("inverters", "named"),
    [
        ((), "inverters"),
        ((("c1/a", 1.0), ("c1/a", 1.0)), "c1/a"),
        ((("c1", 1.0), ("c1/a", 1.0)), "c1"),
        *(((("c1/a", kw),), "c1/a: rating_kw") for kw in (0.0, -5.0, math.nan, math.inf)),
        *((((path, 1.0),), "expected a name") for path in ("", "c1//a", "c1/*", "c1/a\n")),
        ((("plant/a", 1.0),), "got 'plant'"),
        (tuple((f"c{n // 10}/i{n}", 1.0) for n in range(MOST_INVERTERS + 1)), "10,000 inverters"),
        (tuple((f"c1/i{n}", 1.0) for n in range(MOST_CHILDREN + 1)), "c1: expected up to 1,000"),
        ((("x" * (LONGEST_PATH + 1), 1.0),), "200 characters"),
    ],
)
def test_trees_that_cannot_be_are_refused(
    inverters: tuple[tuple[str, float], ...], named: str
) -> None:
    with pytest.raises(InputError, match=r"^control tree") as caught:
        ControlTree(inverters)
    assert named in str(caught.value)


# Names of nodes that a user gives -----------------------------------------------------------------


NAMED = ControlTree((("c1/a", 1.0), ("c1/b", 1.0), ("c10/a", 1.0)))


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
    nodes = find_nodes(NAMED, names)
    assert set(nodes) == found
    assert len(nodes) == len(found), "each once"
