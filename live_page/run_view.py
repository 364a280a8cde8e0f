"""One run as a page asks for it: its plan, its state in a cycle, its powers over a while."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import suppress
from math import ceil
from pathlib import Path
from typing import Any, Final

import msgspec

from bus_schemas.errors import InputError
from bus_schemas.tree import parent_of
from live_page.follower import RunFollower
from live_page.nodes import NodeStates, columns
from recordings.export.viewer_layout import viewer_layout
from recordings.read.run_file import RECORDING_NAME, NothingRecordedError
from studies.metrics import RunMetrics
from studies.metrics.figures_of_merit import shown_in
from sunspec.process import read_accounts

_UPDATE_S: Final = 0.1
"""Time between two updates of a page."""

_READING_S: Final = 0.03
"""So long the recording is read on before others have their turn."""

_CATCH_UP: Final = 5
"""The page shows a fifth of what is new with each update: a recording grows in steps."""

_SLOW_S: Final = 2.0
"""Between two looks at the figures of merit, and at most between two updates."""

_WAITING_S: Final = 0.5
_UPDATE_POINTS: Final = 60
_MOST_POINTS: Final = 2000
_NODE_POINTS: Final = 240
_NODE_MESSAGES: Final = 300_000
"""Messages to read at most for the history of a node."""


class RunView:
    """A run that pages look at. Nothing is read while nobody does.

    `path` is the recording.
    """

    def __init__(self, path: Path) -> None:
        self.path = path / RECORDING_NAME if path.is_dir() else path
        self._states: NodeStates | None = None

    def open(self) -> NodeStates | None:
        """Return the recording; None while it has not begun."""
        if self._states is None and self.path.exists():
            with suppress(NothingRecordedError):
                self._states = NodeStates(RunFollower(self.path))
        return self._states

    def _begun(self) -> NodeStates:
        states = self.open()
        if states is None:
            raise InputError(f"{self.path}: the run has not begun")
        return states

    def plan(self) -> dict[str, Any] | None:
        """Return what stays the same throughout the run; None while it has not begun."""
        states = self.open()
        if states is None:
            return None
        plan, tree = states.follower.plan, states.follower.plan.tree
        place = {node: number for number, node in enumerate(tree.nodes)}
        devices = dict(plan.devices)
        return {
            "run": plan.run_id,
            "plant": plan.plant,
            "scheme": plan.scheme,
            "nodes": [
                {
                    "path": node,
                    "parent": place[parent_of(node)] if node else None,
                    "rating_kw": tree.rating_kw(node),
                    "inverter": tree.is_leaf(node),
                    "external": node in plan.external,
                    "device": devices.get(node),
                }
                for node in tree.nodes
            ],
            "positions_m": plan.positions_m,
            "cycles": plan.cycles,
            "cycle_s": plan.cycle_ns / 1e9,
            "cycle_wall_s": plan.cycle_wall_ns / 1e9,
            "hold_cycles": plan.hold_cycles,
            "start_ms": plan.start_time_ns / 1e6,
            "timezone": plan.timezone,
        }

    def layout(self) -> dict[str, object]:
        """Return a layout of the run for Foxglove and Lichtblick."""
        return viewer_layout(self._begun().follower.plan)

    def window(self, cycles: range, points: int) -> dict[str, Any]:
        """Return the plant's powers over some cycles."""
        return self._begun().follower.powers(cycles, min(points, _MOST_POINTS))

    async def node(self, node: str, cycles: range) -> dict[str, list[float | None]]:
        """Return the powers of a node over some cycles, at most so many that it takes a second."""
        states = self._begun()
        nodes = states.follower.plan.tree.nodes
        if node not in nodes:
            raise InputError(f"{node}: the run has no such node")
        cycles = range(max(cycles.start, 0), min(cycles.stop, states.follower.cycles))
        most = max(_NODE_MESSAGES // (8 * len(nodes)), 20)
        step = max(ceil(len(cycles) / min(_NODE_POINTS, most)), 1)
        rows: list[dict[str, float | None]] = []
        for cycle in cycles[::step]:
            rows.append({"cycle": cycle, **states.series(node, cycle)})
            await asyncio.sleep(0)  # Other pages have their turn.
        return columns(rows) if rows else {"cycle": []}

    async def updates(self, position: float | None, speed: float) -> AsyncIterator[bytes]:
        """Yield the state of the run whenever there is news, as JSON.

        `position` is the cycle to begin with; None: follow the newest one. `speed` is in simulated
        seconds a second; 0: stay there.
        """
        shown, revision, counted = -1, 0, 0
        sent, slow_at = b"", float("-inf")
        async for cycle in self.cycles(position, speed):
            if cycle is None:
                yield b'{"state":"waiting"}'
                continue
            states = self._begun()
            follower = states.follower
            news: dict[str, Any] = {
                "state": follower.state,
                "cycles": follower.cycles,
                "reading": follower.read_share,
                "cycle": cycle,
                "events": follower.events.since(revision),
            }
            revision = follower.events.revision
            if cycle >= 0 and cycle != shown:
                begin = shown + 1 if 0 <= shown < cycle else cycle
                news["frame"] = states.frame(cycle)
                news["plant"] = follower.powers(range(begin, cycle + 1), _UPDATE_POINTS)
                shown = cycle
            if is_slow_due := time.monotonic() > slow_at + _SLOW_S:
                slow_at = time.monotonic()
                if follower.cycles > counted:
                    news["figures"] = _figures(follower.metrics())
                    accounts = read_accounts(self.path.parent)
                    news["devices"] = {account.node: account for account in accounts}
                counted = follower.cycles
            update = msgspec.json.encode(news)
            if is_slow_due or update != sent:
                yield update
            sent = update

    async def cycles(self, position: float | None, speed: float) -> AsyncIterator[int | None]:
        """Yield the cycle to show, at most ten times a second.

        None: the run has not begun; -1: its first cycle has not. Parameters as in `updates`.
        """
        shown = position
        now = time.monotonic()
        while True:
            states = self.open()
            if states is None:
                yield None
                await asyncio.sleep(_WAITING_S)
                continue
            follower = states.follower
            up_to_date = follower.advance(_READING_S)
            before, now = now, time.monotonic()
            newest = follower.cycles - 1
            if shown is None:
                shown = newest
            elif position is None:
                shown += ceil((newest - shown) / _CATCH_UP)
            elif shown < newest:
                shown = min(shown + speed * (now - before) * 1e9 / follower.plan.cycle_ns, newest)
            yield min(int(shown), newest)
            await asyncio.sleep(_UPDATE_S if up_to_date else _READING_S / 3)


def _figures(metrics: RunMetrics | None) -> list[dict[str, str]]:
    """Return the figures that a summary shows, as texts."""
    if metrics is None:
        return []
    return [
        {"title": figure.title, "unit": figure.unit, "value": f"{value:,.{figure.decimals}f}"}
        for figure in shown_in("summary")
        if (value := figure.read(metrics)) is not None
    ]
