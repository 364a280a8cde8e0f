"""Finds the signals and nodes of a run that a user names."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from bus_schemas.errors import InputError, not_one_of
from bus_schemas.messages import Message
from bus_schemas.signals import SIGNALS, Signal
from bus_schemas.tree import CENTRAL, PLANT, ROOT, ControlTree, agent_name

_ALL: Final = "*"
_SUBTREE: Final = "/*"


def find_signals(
    names: str | Iterable[Signal[Message] | str],
) -> tuple[Signal[Message], ...]:
    """Return the recorded signals of these names, or of one text with commas between them."""
    recorded = {signal.name: signal for signal in SIGNALS if signal.logged}
    found = []
    for name in _words(names, "--signals") if isinstance(names, str) else names:
        text = name if isinstance(name, str) else name.name
        if text not in recorded:
            raise InputError.of("--signals", not_one_of(recorded, text))
        found.append(recorded[text])
    return tuple(found)


def find_nodes(
    tree: ControlTree, names: str | Iterable[str], where: str = "--nodes"
) -> tuple[str, ...]:
    agents = find_agents(tree, names, where, also=())
    return tuple(ROOT if agent == CENTRAL else agent for agent in agents)


def find_agents(
    tree: ControlTree,
    names: str | Iterable[str],
    where: str = "--nodes",
    also: tuple[str, ...] = (PLANT,),
) -> tuple[str, ...]:
    """Return the names of some agents: the one grammar of `--nodes`.

    A name is `c2/inv07`, `c1`, `central`, one of `also`, or `c1/*`: a node and all below it; `*` is
    all nodes. One text may hold several with commas between them.
    """
    team = (*also, *(agent_name(node) for node in tree.nodes))
    if isinstance(names, str):
        words = _words(names, where)
    else:  # The path of the central controller is empty.
        words = [word for name in names for word in _words(name, where) or [CENTRAL]]
    found, known = list[str](), frozenset(team)
    for name in words:
        top = CENTRAL if name == _ALL else name.removesuffix(_SUBTREE)
        if top not in known or (top != name and top in also):
            raise InputError.of(where, not_one_of(team, top))
        found.append(top)
        if top != name:
            below = "" if top == CENTRAL else f"{top}/"
            found += [agent_name(node) for node in tree.nodes if node.startswith(below)]
    return tuple(dict.fromkeys(found))


def _words(text: str, where: str) -> list[str]:
    words = [word.strip() for word in text.split(",") if word.strip()]
    if text and not words:  # As `--nodes "$A,$B"` has it if these are not set.
        raise InputError.of(where, f"expected names with commas between them, got {text!r}")
    return words
