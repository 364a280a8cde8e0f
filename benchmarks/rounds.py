"""Measures several ways in alternating rounds, and prints what each came to."""

from __future__ import annotations

import os
import platform
import sys
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import version
from math import isnan, nan
from pathlib import Path
from statistics import median
from typing import TypeVar

import msgspec
import psutil
from harness import Figures
from rich.console import Console

from studies.tables import Column, Table, key_column, print_table

Found = TypeVar("Found", bound=Figures)


def measured(count: int, ways: Mapping[str, Callable[[], Found]]) -> dict[str, list[Found]]:
    """Measure each way once in each round; every round begins with another one.

    Other work on the machine comes and goes: it meets all ways, and ratios of one round hold where
    the figures themselves do not.
    """
    found: dict[str, list[Found]] = {name: [] for name in ways}
    in_turn = deque(ways)
    for number in range(count):
        load = psutil.getloadavg()[0]
        sys.stderr.write(f"round {number + 1} of {count}, load {load:.1f}\n")
        for name in in_turn:
            found[name].append(ways[name]())
        in_turn.rotate()
    return found


def print_rounds(
    title: str,
    found: Mapping[str, Sequence[Figures]],
    columns: Mapping[str, tuple[str, str, int]],
) -> None:
    """Print the figures of each way, and its rate beside that of the first, round by round.

    columns: Field of the figures: title, unit and decimals.
    """
    first, *_ = found.values()
    rows = []
    for name, runs in found.items():
        cells = [
            _spread([getattr(one, field, nan) for one in runs], decimals)
            for field, (_, _, decimals) in columns.items()
        ]
        pairs = zip(first, runs, strict=True)
        ratios = [base.cycles_per_s / one.cycles_per_s for base, one in pairs]
        rows.append((name, *cells, "" if runs is first else _spread(ratios, 2)))
    titles = [Column(what, unit) for what, unit, _ in columns.values()]
    titles.append(Column(f"{next(iter(found))}: times as many cycles/s"))
    machine = (
        f"{platform.system()} {platform.release()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, Zenoh {version('eclipse-zenoh')}"
    )
    notes = ("median (least, most) of all rounds; times as many: round by round", machine)
    print_table(Console(width=100), Table(title, (key_column("", "way"), *titles), rows, notes))


def _spread(values: Iterable[float], decimals: int) -> str:
    known = [value for value in values if not isnan(value)]
    if not known:
        return "-"
    middle, least, most = (f"{of(known):,.{decimals}f}" for of in (median, min, max))
    return f"{middle} ({least}, {most})"


def write_figures(found: Mapping[str, Sequence[Figures]], path: Path | None) -> None:
    """Write all figures as JSON, if they are wanted."""
    if path is not None:
        path.write_bytes(msgspec.json.format(msgspec.json.encode(found), indent=1))
