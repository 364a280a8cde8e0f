"""Kinds of the processes of a run, and the stages that each goes through in a cycle."""

from __future__ import annotations

from typing import Final, Literal, TypeAlias, get_args

from bus_schemas.tree import CENTRAL, PLANT, RECORDER, ControlTree

Kind: TypeAlias = Literal["plant", "central", "supervisor", "direct", "recorder"]
"""Kinds of processes of a run, from the top; the recorder has no place in the tree."""

KINDS: Final[tuple[Kind, ...]] = get_args(Kind)

STAGES: Final[dict[str, tuple[str, ...]]] = {
    "plant": ("begin", "advance"),
    "central": ("request", "solve"),
    "supervisor": ("request", "report", "solve"),
    "direct": ("estimate", "actuate"),
}
"""Stages of a cycle, in their order, of each kind that acts."""

_ALONE: Final[dict[str, Kind]] = {PLANT: "plant", CENTRAL: "central", RECORDER: "recorder"}
"""Agents that are the only ones of their kind."""


def kind_of(agent: str, tree: ControlTree) -> Kind:
    """Return the kind of an agent by its name."""
    return _ALONE.get(agent) or ("direct" if tree.is_leaf(agent) else "supervisor")
