"""Measures several ways in alternating rounds, and prints what each came to."""

from __future__ import annotations

import argparse
import os
import platform
import sys
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from importlib.metadata import version
from math import isnan, nan
from statistics import median
from typing import Final

import psutil
from harness import Figures
from rich.console import Console

from results.tables import Column, Table, key_column, print_table

COLUMNS: Final = (
    Column("cycles/s", "", 1, name="cycles_per_s"),
    Column("processor time", "ms a cycle", 1, name="processor_ms"),
    Column("start-up", "s", 2, name="startup_s"),
    Column("direct controller", "MB, its own", 1, name="own_mb"),
)
"""What each figure is called."""


def options(about: str | None, rounds: int, cycles: int) -> argparse.ArgumentParser:
    """Return the options that all benchmarks in rounds have."""
    parser = argparse.ArgumentParser(description=(about or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=rounds)
    parser.add_argument("--cycles", type=int, default=cycles, help="of a launch in lockstep")
    return parser


def measure(
    title: str, count: int, ways: Mapping[str, Callable[[], Figures]], shown: Collection[str]
) -> None:
    """Measure each way once in each round, and print some figures; each round begins elsewhere.

    Other work on the machine comes and goes: it meets all ways, and ratios of one round hold where
    the figures themselves do not. Ends the program if messages got lost.
    """
    found: dict[str, list[Figures]] = {name: [] for name in ways}
    in_turn = deque(ways)
    for number in range(count):
        sys.stderr.write(f"round {number + 1} of {count}, load {psutil.getloadavg()[0]:.1f}\n")
        for name in in_turn:
            found[name].append(ways[name]())
        in_turn.rotate()
    columns = [column for column in COLUMNS if column.name in shown]
    _print_rounds(f"{title}, {count} rounds", found, columns)
    if lost := sum(each.lost for runs in found.values() for each in runs):
        raise SystemExit(f"{lost:,} messages lost")


def _print_rounds(
    title: str, found: Mapping[str, Sequence[Figures]], columns: Sequence[Column]
) -> None:
    """Print the figures of each way, and its rate beside that of the first, round by round."""
    first, *_ = found.values()
    rows = []
    for name, runs in found.items():
        cells = [
            _spread((getattr(one, column.name, nan) for one in runs), column.decimals)
            for column in columns
        ]
        pairs = zip(first, runs, strict=True)
        ratios = [base.cycles_per_s / one.cycles_per_s for base, one in pairs]
        rows.append((name, *cells, "" if runs is first else _spread(ratios, 2)))
    ratio = Column(f"{next(iter(found))}: times as many cycles/s")
    machine = (
        f"{platform.system()} {platform.release()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, Zenoh {version('eclipse-zenoh')}"
    )
    notes = ("median (least, most) of all rounds; times as many: round by round", machine)
    print_table(Console(width=100), Table(title, [key_column("way"), *columns, ratio], rows, notes))


def _spread(values: Iterable[float], decimals: int) -> str:
    known = [value for value in values if not isnan(value)]
    if not known:
        return "-"
    middle, least, most = (f"{of(known):,.{decimals}f}" for of in (median, min, max))
    return f"{middle} ({least}, {most})"
