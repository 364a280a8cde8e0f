"""What the page of a run asks for: its plan, its states and powers, its updates."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import suppress
from math import ceil
from pathlib import Path
from typing import Any, Final

import msgspec

from bus_schemas.errors import InputError
from bus_schemas.tree import parent_of
from live_page.follower import RunFollower
from live_page.plant_state import PlantState, columns
from live_page.run_events import Event
from recordings.read.run_file import RECORDING_NAME, NothingRecordedError
from results.figures import Figures, Shown, shown_in
from results.plants import PlantFigures
from sunspec.process import read_accounts

_UPDATE_S: Final = 0.1
"""Time between two updates of a page."""

_READING_S: Final = 0.03
"""So long the recording is read on before others have their turn."""

_CATCH_UP: Final = 5
"""The page shows a fifth of what is new with each update: a recording grows in steps."""

_SLOW_S: Final = 1.0
"""Between two looks at events and real inverters, and at most between two updates."""

_FIGURES_SHARE: Final = 10.0
"""The figures of merit wait for so many times as long as they took: a day's take 25 ms."""

_WAITING_S: Final = 0.5
_UPDATE_POINTS: Final = 60
_MOST_POINTS: Final = 2000
_NODE_POINTS: Final = 240
_NODE_MESSAGES: Final = 300_000
"""Messages to read at most for the history of a node."""


class RunView:
    """A run that pages look at. Nothing is read while no page is open.

    `path` is the recording.
    """

    def __init__(self, path: Path) -> None:
        self.path = path / RECORDING_NAME if path.is_dir() else path
        self._opened: tuple[RunFollower, PlantState] | None = None

    def open(self) -> RunFollower | None:
        """Return the recording; None while it has not begun."""
        if self._opened is None and self.path.exists():
            with suppress(NothingRecordedError):
                follower = RunFollower(self.path)
                self._opened = follower, PlantState(follower)
        return self._opened[0] if self._opened else None

    def _begun(self) -> tuple[RunFollower, PlantState]:
        self.open()
        if self._opened is None:
            raise InputError(f"{self.path}: the run has not begun")
        return self._opened

    def plan(self) -> dict[str, Any] | None:
        """Return what stays the same throughout the run; None while it has not begun."""
        follower = self.open()
        if follower is None:
            return None
        plan, tree = follower.plan, follower.plan.tree
        number = {node: number for number, node in enumerate(tree.nodes)}
        devices, leaves = dict(plan.site.devices), {*tree.leaves}
        capacity_kwh = {one.path: one.capacity_kwh for one in plan.storages}
        irradiance = follower.run.scenario_table().get("irradiance", {})
        return {
            "run": plan.run_id,
            "plant": plan.plant,
            "scheme": plan.control.scheme,
            "nodes": [
                {
                    "path": node,
                    "parent": number[parent_of(node)] if node else None,
                    "rating_kw": tree.rating_kw(node),
                    "inverter": node in leaves,
                    "capacity_kwh": capacity_kwh.get(node),
                    "external": node in plan.access.external,
                    "device": devices.get(node),
                }
                for node in tree.nodes
            ],
            "positions_m": plan.site.positions_m,
            "plants": tree.meters[1:],
            "has_clouds": irradiance.get("kind") == "clouds" and bool(plan.site.positions_m),
            "cycles": plan.timing.cycles,
            "cycle_s": plan.timing.cycle_ns / 1e9,
            "cycle_wall_s": plan.timing.cycle_wall_ns / 1e9,
            "hold_cycles": plan.control.hold_cycles,
            "start_ms": plan.timing.start_time_ns / 1e6,
            "timezone": plan.timing.timezone,
        }

    def window(self, cycles: range, points: int) -> dict[str, Any]:
        return self._begun()[0].powers(cycles, min(points, _MOST_POINTS))

    async def node(self, node: str, cycles: range) -> dict[str, list[float | None]]:
        """Return the powers of a node over some cycles, at most so many that it takes a second."""
        follower, state = self._begun()
        nodes = follower.plan.tree.nodes
        if node not in nodes:
            raise InputError(f"{node}: the run has no such node")
        cycles = range(max(cycles.start, 0), min(cycles.stop, follower.cycles))
        most = max(_NODE_MESSAGES // (8 * len(nodes)), 20)
        step = max(ceil(len(cycles) / min(_NODE_POINTS, most)), 1)
        rows: list[dict[str, float | None]] = []
        for cycle in cycles[::step]:
            rows.append({"cycle": cycle, **state.powers(node, cycle)})
            await asyncio.sleep(0)  # Other pages have their turn.
        return columns(rows) if rows else {"cycle": []}

    async def newest(self) -> tuple[RunFollower, PlantState]:
        """Read on to the end of the recording."""
        follower, state = self._begun()
        while not follower.advance(_READING_S):
            await asyncio.sleep(0)  # Pages have their turn.
        return follower, state

    async def updates(self, position: float | None, speed: float) -> AsyncIterator[bytes]:
        """Yield the state of the run whenever there is news, as JSON.

        `position` is the cycle to begin with; None: follow the newest one. `speed` is in simulated
        seconds a second; 0: stay there.
        """
        shown, counted = -1, -1
        events: list[Event] | None = None
        sent, slow_at, figures_at = b"", float("-inf"), float("-inf")
        async for cycle in self.cycles(position, speed):
            if cycle is None:
                yield b'{"state":"waiting"}'
                continue
            follower, state = self._begun()
            news: dict[str, Any] = {
                "state": follower.state,
                "cycles": follower.cycles,
                "reading": follower.read_share,
                "cycle": cycle,
            }
            if cycle >= 0 and cycle != shown:
                begin = shown + 1 if 0 <= shown < cycle else cycle
                news["frame"] = state.frame(cycle)
                news["plant"] = follower.powers(range(begin, cycle + 1), _UPDATE_POINTS)
                shown = cycle
            began_at = time.monotonic()
            if cycle != counted and began_at >= figures_at:
                rows = _figures(follower.metrics(cycle + 1), follower.plants(cycle + 1))
                news["figures"] = {"cycle": cycle, "rows": rows}
                counted = cycle
                figures_at = time.monotonic() + _FIGURES_SHARE * (time.monotonic() - began_at)
            if is_slow_due := began_at > slow_at + _SLOW_S:
                slow_at = began_at
                if events is not (events := follower.events):
                    news["events"] = events
                accounts = read_accounts(self.path.parent)
                news["devices"] = {account.node: account for account in accounts}
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
            follower = self.open()
            if follower is None:
                yield None
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
                shown = min(
                    shown + speed * (now - before) * 1e9 / follower.plan.timing.cycle_ns, newest
                )
            yield min(int(shown), newest)
            await asyncio.sleep(_UPDATE_S if up_to_date else _READING_S / 3)


def _figures(found: Figures | None, plants: Iterator[PlantFigures]) -> list[dict[str, str]]:
    if found is None:
        return []
    return [
        {"title": figure.title, "unit": figure.unit, "value": f"{value:z,.{figure.decimals}f}"}
        for figure in shown_in(Shown.SUMMARY)
        if (value := found[figure.name]) is not None
    ] + [
        {"title": f"Delivered by {one.name}", "unit": "kWh", "value": f"{one.delivered_kwh:,.1f}"}
        for one in plants
    ]
