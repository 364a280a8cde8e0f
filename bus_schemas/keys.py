"""Keys on the bus: `<plant>/<path of the node in the control tree>/<signal>`.

A Zenoh session adds the run's namespace before the plant's name by itself, so that two runs that
happen to meet on one network do not hear each other.
"""

from __future__ import annotations

from bus_schemas.messages import Message
from bus_schemas.signals import Port, ports
from bus_schemas.tree import ControlTree


class KeyTable:
    """Keys of a plant's ports, both ways."""

    def __init__(self, plant: str, tree: ControlTree) -> None:
        self.plant = plant
        self._port_of = {self.key(port): port for port in ports(tree)}

    @property
    def ports(self) -> tuple[Port[Message], ...]:
        return tuple(self._port_of.values())

    def key(self, port: Port[Message]) -> str:
        """Key of a port, for instance `oahu/c2/inv07/impp` or `oahu/dispatch`."""
        return f"{self.plant}/{port}"

    def port(self, key: str) -> Port[Message] | None:
        """Port that a key names, or None where the control tree has no such node or signal."""
        return self._port_of.get(key)

    def alive_key(self, agent: str) -> str:
        return f"{self.plant}/{agent}/alive"
