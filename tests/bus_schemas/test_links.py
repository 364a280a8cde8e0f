"""Who must be linked with whom: derived from the table of signals."""

from __future__ import annotations

import pytest

from bus_schemas.links import explicit_links
from bus_schemas.tree import ControlTree

SMALL = ControlTree((("c1/a", 1.0), ("c1/b", 1.0), ("c2/a", 1.0)))
RAGGED = ControlTree((("inv01", 1.0), ("c1/inv02", 1.0), ("z1/c1/inv03", 1.0)))


def test_the_links_of_a_small_plant() -> None:
    assert explicit_links(SMALL).pairs == (
        ("recorder", "plant"),
        ("recorder", "central"),
        ("recorder", "c1"),
        ("recorder", "c2"),
        ("recorder", "c1/a"),
        ("recorder", "c1/b"),
        ("recorder", "c2/a"),
        ("plant", "central"),
        ("plant", "c1"),
        ("plant", "c2"),
        ("plant", "c1/a"),
        ("plant", "c1/b"),
        ("plant", "c2/a"),
        ("central", "c1"),
        ("central", "c2"),
        ("c1", "c1/a"),
        ("c1", "c1/b"),
        ("c2", "c2/a"),
    )


def test_an_inverter_directly_below_the_central_controller_is_linked_with_it() -> None:
    assert ("central", "inv01") in explicit_links(RAGGED).pairs


@pytest.mark.parametrize("tree", [SMALL, RAGGED])
def test_no_inverter_needs_a_port(tree: ControlTree) -> None:
    assert not set(explicit_links(tree).listening) & set(tree.leaves)


@pytest.mark.parametrize("tree", [SMALL, RAGGED])
def test_a_pair_is_linked_once(tree: ControlTree) -> None:
    pairs = explicit_links(tree).pairs
    assert len({frozenset(pair) for pair in pairs}) == len(pairs)


def test_endpoints_of_those_who_listen_connect_or_do_both() -> None:
    links = explicit_links(SMALL)
    assert links.listening == ("recorder", "plant", "central", "c1", "c2")
    tcp_ports = {agent: 40000 + place for place, agent in enumerate(links.listening)}
    assert links.endpoints("recorder", tcp_ports) == (["tcp/127.0.0.1:40000"], [])
    assert links.endpoints("c1", tcp_ports) == (
        ["tcp/127.0.0.1:40003"],
        ["tcp/127.0.0.1:40000", "tcp/127.0.0.1:40001", "tcp/127.0.0.1:40002"],
    )
    assert links.endpoints("c1/b", tcp_ports) == (
        [],
        ["tcp/127.0.0.1:40000", "tcp/127.0.0.1:40001", "tcp/127.0.0.1:40003"],
    )


@pytest.mark.parametrize("tree", [SMALL, RAGGED])
def test_whoever_connects_finds_somebody_listening(tree: ControlTree) -> None:
    links = explicit_links(tree)
    tcp_ports = {agent: 40000 + place for place, agent in enumerate(links.listening)}
    listens = {end for agent in tree.agents() for end in links.endpoints(agent, tcp_ports)[0]}
    for agent in tree.agents():
        connects = links.endpoints(agent, tcp_ports)[1]
        assert set(connects) <= listens
        assert connects or agent == "recorder"
