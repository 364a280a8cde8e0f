"""One run as a page asks for it: its plan, its state in a cycle, its powers over a while."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from math import ceil
from pathlib import Path
from typing import Any, Final

import msgspec

from bus_schemas.errors import InputError
from bus_schemas.tree import parent_of
from live_page.follower import RunFollower
from live_page.nodes import NodeStates
from recordings.read.run_file import RECORDING_NAME, NothingRecordedError
from studies.metrics.figures_of_merit import shown_in

UPDATE_S: Final = 0.1
"""Time between two updates of a page."""

_READING_S: Final = 0.03
"""So long the recording is read on before others have their turn."""

_CATCH_UP: Final = 5
"""The page shows a fifth of what is new with each update: a recording grows in steps."""

_FIGURES_S: Final = 2.0
_HEARTBEAT_S: Final = 2.0
_WAITING_S: Final = 0.5
_UPDATE_POINTS: Final = 60
_MOST_POINTS: Final = 2000
_NODE_POINTS: Final = 240
_NODE_MESSAGES: Final = 300_000
"""Messages to read at most for the history of a node."""


@dataclass
class _Sent:
    """What a browser has been told, and when."""

    state: dict[str, Any] = field(default_factory=dict)
    cycle: int = -1
    revision: int = 0
    figures_at: float = 0.0
    at: float = 0.0


class RunView:
    """A run that pages look at. Nothing is read while nobody does.

    Attributes
    ----------
    path
        The recording.
    watched
        How many browsers follow it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path / RECORDING_NAME if path.is_dir() else path
        self.watched = 0
        self._follower: RunFollower | None = None
        self._states: NodeStates | None = None
        self._figures: list[dict[str, Any]] = []
        self._figures_at = 0.0
        self._figures_cycles = 0

    def close(self) -> None:
        """Close the recording."""
        if self._follower is not None:
            self._follower.close()

    def open(self) -> RunFollower | None:
        """Return the recording; None while it has not begun."""
        if self._follower is None:
            try:
                self._follower = RunFollower(self.path)
            except NothingRecordedError:
                return None
            except InputError:
                if self.path.exists():
                    raise
                return None
            self._states = NodeStates(self._follower)
        return self._follower

    def plan(self) -> dict[str, Any] | None:
        """Return what stays the same throughout the run."""
        follower = self.open()
        if follower is None:
            return None
        plan, tree = follower.plan, follower.plan.tree
        place = {node: number for number, node in enumerate(tree.nodes)}
        return {
            "run": plan.run_id,
            "plant": plan.plant,
            "driver": follower.run.metadata["run"].get("driver"),
            "scheme": plan.scheme,
            "nodes": [
                {
                    "path": node,
                    "parent": place[parent_of(node)] if node else None,
                    "rating_kw": tree.rating_kw(node),
                    "inverter": tree.is_leaf(node),
                    "external": node in plan.external,
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

    def window(self, cycles: range, points: int) -> dict[str, Any]:
        """Return the plant's powers over some cycles."""
        follower = self.open()
        return {} if follower is None else follower.powers(cycles, min(points, _MOST_POINTS))

    async def node(self, node: str, cycles: range) -> dict[str, list[float | None]]:
        """Return the powers of a node over some cycles, at most so many that it takes a second."""
        follower, states = self.open(), self._states
        if follower is None or states is None or node not in follower.plan.tree.nodes:
            raise InputError(f"{node}: the run has no such node")
        cycles = range(max(cycles.start, 0), min(cycles.stop, follower.cycles))
        most = max(_NODE_MESSAGES // (8 * len(follower.plan.tree.nodes)), 20)
        step = max(ceil(len(cycles) / min(_NODE_POINTS, most)), 1)
        columns: dict[str, list[float | None]] = {"cycle": []}
        for cycle in cycles[::step]:
            columns["cycle"].append(cycle)
            for name, value in states.series(node, cycle).items():
                columns.setdefault(name, []).append(value)
            await asyncio.sleep(0)  # Other pages have their turn.
        return columns

    async def updates(self, position: float | None, speed: float) -> AsyncIterator[bytes]:
        """Yield the state of the run whenever there is news, as JSON.

        Parameters
        ----------
        position
            The cycle to begin with; None: follow the newest one.
        speed
            Simulated seconds a second; 0: stay there.
        """
        self.watched += 1
        try:
            async for message in self._messages(position, speed):
                yield msgspec.json.encode(message)
        finally:
            self.watched -= 1

    async def _messages(
        self, position: float | None, speed: float
    ) -> AsyncIterator[dict[str, Any]]:
        sent = _Sent()
        shown = position
        now = time.monotonic()
        while True:
            follower = self.open()
            if follower is None:
                yield {"state": "waiting"}
                await asyncio.sleep(_WAITING_S)
                continue
            up_to_date = follower.advance(_READING_S)
            before, now = now, time.monotonic()
            newest = follower.cycles - 1
            if shown is None:
                shown = newest
            elif position is None:
                shown += ceil((newest - shown) / _CATCH_UP)
            elif shown < newest:
                shown = min(shown + speed * (now - before) * 1e9 / follower.plan.cycle_ns, newest)
            self._work_out_figures(follower, now)
            read_share = None if up_to_date else round(follower.read_share, 3)
            news = self._news(follower, min(int(shown), newest), read_share, sent)
            if news:
                sent.at = now
                yield news
            await asyncio.sleep(UPDATE_S if up_to_date else _READING_S / 3)

    def _news(
        self, follower: RunFollower, cycle: int, read_share: float | None, sent: _Sent
    ) -> dict[str, Any]:
        """Return what a browser does not know yet; nothing if it was told all and recently."""
        state: dict[str, Any] = {
            "state": follower.state,
            "cycles": follower.cycles,
            "reading": read_share,
        }
        is_new = (state, cycle) != (sent.state, sent.cycle) or self._figures_at > sent.figures_at
        if not (
            is_new
            or follower.events.revision > sent.revision
            or time.monotonic() > sent.at + _HEARTBEAT_S
        ):
            return {}
        message = {**state, "cycle": cycle, "events": follower.events.since(sent.revision)}
        if cycle >= 0 and cycle != sent.cycle and self._states is not None:
            begin = sent.cycle + 1 if 0 <= sent.cycle < cycle else cycle
            message["frame"] = self._states.frame(cycle)
            message["plant"] = follower.powers(range(begin, cycle + 1), _UPDATE_POINTS)
        if self._figures_at > sent.figures_at:
            message["figures"] = self._figures
        sent.state, sent.cycle = state, cycle
        sent.revision, sent.figures_at = follower.events.revision, self._figures_at
        return message

    def _work_out_figures(self, follower: RunFollower, now: float) -> None:
        """Work out the figures of merit so far, unless that was just done."""
        if now < self._figures_at + _FIGURES_S or follower.cycles == self._figures_cycles:
            return
        metrics = follower.metrics()
        self._figures_at, self._figures_cycles = now, follower.cycles
        if metrics is not None:
            values = [(figure, figure.read(metrics)) for figure in shown_in("summary")]
            self._figures = [
                {
                    "title": figure.title,
                    "unit": figure.unit,
                    "value": None if value is None else f"{value:,.{figure.decimals}f}",
                }
                for figure, value in values
                if value is not None
            ]
