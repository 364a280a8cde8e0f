"""The control tree: parents and children, given by paths and ratings of the inverters."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, takewhile
from math import fsum
from typing import Final

from bus_schemas.errors import InputError

CENTRAL: Final = "central"
PLANT: Final = "plant"
RECORDER: Final = "recorder"
REPLAYER: Final = "replayer"
OPERATOR: Final = "operator"

ROOT: Final = ""
"""The central controller's path: its keys have no node part."""

LONGEST_PATH: Final = 200
MOST_CHILDREN: Final = 1_000
MOST_INVERTERS: Final = 10_000
LARGEST_RATING_KW: Final = 1e9

RESERVED_NAMES: Final = frozenset({CENTRAL, PLANT, RECORDER, REPLAYER, OPERATOR, "alive"})
_NAME = re.compile(rf"[A-Za-z0-9_-]{{1,{LONGEST_PATH}}}")


def agent_name(path: str) -> str:
    return path or CENTRAL


@dataclass(frozen=True)
class ControlTree:
    """Inverters as leaves, clusters above them, the central controller at the root.

    There may be any number of tiers. Storages stand beside inverters or clusters; their ratings do
    not count in those of parents.

    inverters: Path and AC rating [kW] of each inverter, in the plant's order.
    storages: The same of each storage.
    plants: Of a fleet, the name and the export limit [kW] of each plant: a node of the first tier,
        which is rated by what it may feed in.
    """

    inverters: tuple[tuple[str, float], ...]
    storages: tuple[tuple[str, float], ...] = ()
    plants: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        for objection in self._objections():
            raise InputError(f"control tree: {objection}")

    def _objections(self) -> Iterator[str]:
        count = len(self.inverters)
        if not 0 < count <= MOST_INVERTERS:
            yield f"expected 1 to {MOST_INVERTERS:,} inverters, got {count:,}"
        seen: set[str] = set()
        for path, rating_kw in (*self.inverters, *self.storages):
            for part in path.split("/"):
                check_name(part, f"control tree, node {path!r}")
            if len(path) > LONGEST_PATH:
                yield f"{path[:40]}...: expected up to {LONGEST_PATH} characters, got {len(path)}"
            if not 0.0 < rating_kw <= LARGEST_RATING_KW:
                expected = f"a number above 0 and up to {LARGEST_RATING_KW:g}"
                yield f"{path}: rating_kw: expected {expected}, got {rating_kw:g}"
            if path in seen or path in self._children_of:
                yield f"{path}: expected one node of this name, got several"
            seen.add(path)
        for path, children in self._children_of.items():
            if not self.leaves_below(path):
                yield f"{agent_name(path)}: expected inverters below it, got storages alone"
            if len(children) > MOST_CHILDREN:
                expected = f"up to {MOST_CHILDREN:,} children, or a tier between"
                yield f"{agent_name(path)}: expected {expected}, got {len(children):,}"

    @cached_property
    def _children_of(self) -> dict[str, tuple[str, ...]]:
        children: dict[str, dict[str, None]] = {ROOT: {}}
        for leaf, _ in (*self.inverters, *self.storages):
            for child, parent in pairwise((leaf, *ancestors(leaf))):
                children.setdefault(parent, {})[child] = None
        return {path: tuple(kids) for path, kids in children.items()}

    @cached_property
    def _ratings_kw(self) -> dict[str, float]:
        of_parents = dict(self._inverters_kw)
        if self.plants:
            limits = {name: min(limit, of_parents[name]) for name, limit in self.plants}
            of_parents |= limits | {ROOT: fsum(limits.values())}
        return of_parents | dict(self.storages)

    def inverters_kw(self, path: str) -> float:
        """Sum of the ratings of the inverters at or below a node."""
        return self._inverters_kw[path]

    @cached_property
    def _inverters_kw(self) -> dict[str, float]:
        kw = [rating_kw for _, rating_kw in self.inverters]
        return {path: fsum(kw[at] for at in below) for path, below in self._leaves_below.items()}

    @property
    def meters(self) -> tuple[str, ...]:
        """Nodes that have a meter: the root, and each plant of a fleet."""
        return (ROOT, *(name for name, _ in self.plants))

    @cached_property
    def leaves(self) -> tuple[str, ...]:
        """Paths of the inverters."""
        return tuple(path for path, _ in self.inverters)

    @cached_property
    def storage_paths(self) -> tuple[str, ...]:
        return tuple(path for path, _ in self.storages)

    @property
    def devices(self) -> tuple[str, ...]:
        """Paths of the inverters and the storages."""
        return self.leaves + self.storage_paths

    @cached_property
    def parents(self) -> tuple[str, ...]:
        """Paths of all nodes that have children, the root first, each before its descendants."""
        return tuple(sorted(self._children_of, key=lambda path: (depth(path), path)))

    @cached_property
    def nodes(self) -> tuple[str, ...]:
        return self.parents + self.devices

    @cached_property
    def height(self) -> int:
        return max(depth(leaf) for leaf in self.leaves)

    def children(self, path: str) -> tuple[str, ...]:
        return self._children_of.get(path, ())

    def is_leaf(self, path: str) -> bool:
        return path not in self._children_of

    def is_storage(self, path: str) -> bool:
        return path in self.storage_paths

    def rating_kw(self, path: str) -> float:
        """Rating of a device; of a parent, what the inverters below it may feed in together."""
        return self._ratings_kw[path]

    def sharing_kw(self, path: str) -> float:
        """Rating by which a node shares the dispatch: in a fleet what its plant may feed in."""
        if self.is_storage(path):
            return 0.0
        plant, slash, _ = path.partition("/")
        part = self.rating_kw(plant) / self.inverters_kw(plant) if self.plants and slash else 1.0
        return self.rating_kw(path) * part

    def storage_kw(self, path: str) -> float:
        """Rating of the storages at or below a node."""
        below = f"{path}/" if path else ""
        return fsum(
            rating_kw
            for storage, rating_kw in self.storages
            if storage == path or storage.startswith(below)
        )

    def leaves_below(self, path: str) -> tuple[int, ...]:
        """Positions, in the plant's order, of the inverters at or below a node."""
        return self._leaves_below.get(path, ())

    @cached_property
    def _leaves_below(self) -> dict[str, tuple[int, ...]]:
        found: dict[str, list[int]] = {}
        for index, leaf in enumerate(self.leaves):
            for path in (leaf, *ancestors(leaf)):
                found.setdefault(path, []).append(index)
        return {path: tuple(indexes) for path, indexes in found.items()}

    def agents(self) -> tuple[str, ...]:
        """Names of all agents that a run has, the recorder and the plant first."""
        return (RECORDER, PLANT, *(agent_name(path) for path in self.nodes))


def ancestors(path: str) -> tuple[str, ...]:
    """Paths above a node, upwards."""
    parts = path.split("/") if path else []
    return tuple("/".join(parts[:end]) for end in range(len(parts) - 1, -1, -1))


def common_ancestor(paths: Collection[str]) -> str:
    """Return the lowest node that all of these are at or below."""
    parts = [path.split("/") for path in paths]
    pairs = zip(min(parts), max(parts), strict=False)
    return "/".join(part for part, _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def depth(path: str) -> int:
    """Return the tier of a node: 0 for the root."""
    return path.count("/") + 1 if path else 0


def parent_of(path: str) -> str:
    return path.rpartition("/")[0]


def check_name(name: str, where: str) -> None:
    """Refuse a node name that could not stand in a key."""
    if not _NAME.fullmatch(name):
        expected = f"a name of up to {LONGEST_PATH} characters: letters, digits, '_' and '-'"
        raise InputError.of(where, f"expected {expected}, got {name!r}")
    if name in RESERVED_NAMES:
        reserved = ", ".join(sorted(RESERVED_NAMES))
        raise InputError.of(where, f"expected a name other than {reserved}, got {name!r}")
