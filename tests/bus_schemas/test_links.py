"""Who must be linked with whom: derived from the table of signals."""

from __future__ import annotations

from bus_schemas.links import explicit_links
from bus_schemas.tree import ControlTree

SMALL = ControlTree((("c1/a", 1.0), ("c1/b", 1.0), ("c2/a", 1.0)))


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
