"""The control tree: who is whose parent, and which trees are refused."""

from __future__ import annotations

import math

import pytest

from bus_schemas.errors import InputError
from bus_schemas.tree import (
    LONGEST_PATH,
    MOST_CHILDREN,
    MOST_INVERTERS,
    ROOT,
    ControlTree,
    agent_name,
    as_ratings,
)

TREE = ControlTree(
    (("c2/inv03", 100.0), ("c1/inv01", 250.0), ("inv09", 30.0), ("z1/c1/inv02", 70.0))
)


def test_inverters_keep_the_order_of_the_plant() -> None:
    assert TREE.leaves == ("c2/inv03", "c1/inv01", "inv09", "z1/c1/inv02")


def test_parents_come_before_their_descendants() -> None:
    assert TREE.parents == (ROOT, "c1", "c2", "z1", "z1/c1")
    assert TREE.nodes == TREE.parents + TREE.leaves


def test_children_are_one_tier_below() -> None:
    assert TREE.children(ROOT) == ("c2", "c1", "inv09", "z1")
    assert TREE.children("z1") == ("z1/c1",)
    assert TREE.children("z1/c1") == ("z1/c1/inv02",)
    assert TREE.children("inv09") == ()


def test_a_cluster_is_rated_as_its_inverters_together() -> None:
    tree = ControlTree((("c1/a", 100.0), ("c1/b", 50.0), ("c2/a", 25.0)))
    assert [tree.rating_kw(node) for node in ("c1/a", "c1", "c2", ROOT)] == [100, 150, 25, 175]


def test_leaves_below_are_places_in_the_plants_order() -> None:
    tree = ControlTree((("c1/a", 1.0), ("c10/a", 1.0), ("c1/b", 1.0)))
    assert tree.leaves_below("c1") == (0, 2)
    assert tree.leaves_below("c10") == (1,)
    assert tree.leaves_below("c1/b") == (2,)
    assert tree.leaves_below(ROOT) == (0, 1, 2)


def test_the_height_is_that_of_the_deepest_branch() -> None:
    assert TREE.height == 3
    assert ControlTree((("inv01", 1.0),)).height == 1


def test_everybody_has_a_name_on_the_bus() -> None:
    tree = ControlTree((("c1/a", 1.0), ("c2/a", 1.0)))
    assert tree.agents() == ("recorder", "plant", "central", "c1", "c2", "c1/a", "c2/a")
    assert (agent_name(ROOT), agent_name("c1")) == ("central", "c1")


@pytest.mark.parametrize(
    ("inverters", "named"),
    [
        ((), "inverters"),
        ((("c1/a", 1.0), ("c1/a", 1.0)), "c1/a"),
        ((("c1", 1.0), ("c1/a", 1.0)), "c1"),
        *(((("c1/a", kw),), "node c1/a: rating_kw") for kw in (0.0, -5.0, math.nan, math.inf)),
        *((((path, 1.0),), "name: expected") for path in ("", "c1//a", "c1/*", "c1/a\n")),
        ((("plant/a", 1.0),), "got 'plant'"),
    ],
)
def test_trees_that_cannot_be_are_refused(
    inverters: tuple[tuple[str, float], ...], named: str
) -> None:
    with pytest.raises(InputError, match=r"^control tree") as caught:
        ControlTree(inverters)
    assert named in str(caught.value)


@pytest.mark.parametrize(
    ("names", "named"),
    [
        ([f"c{n // 10}/i{n}" for n in range(MOST_INVERTERS + 1)], "4,000 inverters"),
        ([f"c1/i{n}" for n in range(MOST_CHILDREN + 1)], "c1: expected up to 1,000 children"),
        (["x", "x" * (LONGEST_PATH + 1)], "200 characters"),
    ],
    ids=["inverters", "children", "characters"],
)
def test_a_tree_that_is_too_large_to_be_spoken_of_is_refused(names: list[str], named: str) -> None:
    assert len(as_ratings(names[:-1], [1.0] * (len(names) - 1)).leaves) == len(names) - 1
    with pytest.raises(InputError, match=named):
        as_ratings(names, [1.0] * len(names))
