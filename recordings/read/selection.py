"""What a user names of a run, signals and nodes, found in its table and its control tree."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Final

from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import SIGNALS, Signal
from bus_schemas.tree import CENTRAL, ROOT, ControlTree, agent_name

_NEAR: Final = 4
"""How many near names are listed."""

_LISTED: Final = 12
"""Up to so many names are listed where none is near."""

_SUBTREE: Final = "/*"


def find_signals(names: Iterable[Signal[Message] | str]) -> tuple[Signal[Message], ...]:
    """Return the signals of these names, those that are recorded.

    Raises
    ------
    InputError
        There is no such signal, or it is never recorded.
    """
    recorded = {signal.name: signal for signal in SIGNALS if signal.logged}
    found = []
    for name in names:
        text = name if isinstance(name, str) else name.name
        if text not in recorded:
            raise InputError(f"signal {text!r}: not in a recording, {_near(text, recorded)}")
        found.append(recorded[text])
    return tuple(found)


def find_nodes(tree: ControlTree, names: str | Iterable[str]) -> tuple[str, ...]:
    """Return the paths of these nodes; the central controller goes by its name too.

    `c1/*` is `c1` and all below it, as for `heliarch verify`.

    Raises
    ------
    InputError
        The control tree has no such node.
    """
    found: list[str] = []
    for name in [names] if isinstance(names, str) else names:
        path = find_node(tree, name.removesuffix(_SUBTREE))
        below = f"{path}/" if path != ROOT else ""
        found.append(path)
        if name.endswith(_SUBTREE):
            found += [node for node in tree.nodes if node != path and node.startswith(below)]
    return tuple(dict.fromkeys(found))


def find_node(tree: ControlTree, name: str) -> str:
    """Return the path of one node, see `find_nodes`.

    Raises
    ------
    InputError
        The control tree has no such node.
    """
    path = ROOT if name == CENTRAL else name
    if path not in tree.nodes:
        known = [agent_name(node) for node in tree.nodes]
        raise InputError(f"node {name!r}: not in this run, {_near(name, known)}")
    return path


def _near(name: str, known: Iterable[str]) -> str:
    names = list(known)
    near = get_close_matches(name, names, n=_NEAR)
    if near:
        return f"near are {', '.join(near)}"
    rest = len(names) - _LISTED
    return f"accepted are {', '.join(names[:_LISTED])}" + (f" and {rest} more" if rest > 0 else "")
