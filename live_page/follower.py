"""Follows a recording chunk by chunk: to its end, and on while it is being written.

It keeps the plant's powers in every cycle, when each agent was heard, the cycles of every chunk,
and the newest events. All else is read from the file when somebody looks at it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from sys import maxsize
from typing import Final, Literal, TypeAlias

import numpy as np

from bus_schemas.codec import UNREADABLE
from bus_schemas.messages import Dispatch, Message, Meter, Notice, Production, Run
from bus_schemas.signals import DISPATCH, METER, NOTICE, PRODUCTION, RUN, Port
from bus_schemas.tree import PLANT, RECORDER
from live_page.run_events import Event, events_of
from recordings.inspect.agent_states import AgentStates, Change
from recordings.read.mcap_file import Chunk
from recordings.read.reader import RunReader, stop_after
from recordings.read.series import SeriesCollector, columns_of
from results.figures import Figures, run_figures
from results.plants import PlantFigures, plant_figures
from results.report.decimation import extremes
from results.run_document import End, Outcome, failure_in
from sim_plant.orders import order_event

State: TypeAlias = Literal["waiting", "running", "stalled"] | End
"""Before the first cycle; going on; nothing new for a while; or how the run ended."""

_STALLED_S: Final = 5.0
"""Nothing new in the file for this long, or for three cycles, is worth saying."""


class RunFollower:
    """A recording, as far as it has been read.

    `cycles` are those that the plant has completed, `states` how the agents were in them.
    """

    def __init__(self, path: Path) -> None:
        self.run = RunReader(path)
        self.plan = self.run.plan
        self.cycles = 0
        self.states = AgentStates(self.plan)
        self._noted: list[Change] = []
        self._events: list[Event] | None = None
        self._stops: set[int] = set()
        self._failure, self._finished = "", False
        self._chunk_cycles: list[range] = []
        self._powers = SeriesCollector(self.plan, columns_of(self.plan))

    def advance(self, budget_s: float) -> bool:
        """Read on for a while; return whether all that is in the file has been read."""
        outline = self.run.outline
        if not outline.closed and self._next_chunk() is None:
            self.run.join()
        until = time.monotonic() + budget_s
        while (chunk := self._next_chunk()) is not None:
            self._read(chunk)
            if time.monotonic() >= until:
                break
        if self.run.outline.closed and self._next_chunk() is None and not self._finished:
            self._finished = True
            self.states.finish(self.states.end_cycle(stop_after(self._stops, self.states.newest)))
            self._events = None
        if not self._failure and (failure := failure_in(self.run.path.parent)):
            self._failure = failure
            self._note("failure", self.cycles, "launcher", failure)
        return self._next_chunk() is None

    @property
    def events(self) -> list[Event]:
        """What happened so far; the same list until there is news."""
        if self._events is None:
            self._events = events_of([*self._noted, *self._changes()])
        return self._events

    @property
    def state(self) -> State:
        outcome = self._outcome
        if self.run.outline.closed or outcome.kind != "unfinished":
            return outcome.kind
        if not self.cycles:
            return "waiting"
        longest_s = max(_STALLED_S, 3.0 * self.plan.timing.cycle_wall_ns / 1e9)
        age_s = time.time() - max((stat.st_mtime for stat in self.run.stats()), default=0.0)
        return "stalled" if age_s > longest_s else "running"

    @property
    def _outcome(self) -> Outcome:
        """How the run ended, as far as it has been read."""
        stop_cycle = stop_after(self._stops, self.states.newest)
        return Outcome(None, self._failure, stop_cycle, self.plan.timing.cycles)

    @property
    def read_share(self) -> float | None:
        """Share of the file's chunks that has been read; None: all of them."""
        if self._next_chunk() is None:
            return None
        return round(len(self._chunk_cycles) / len(self.run.outline.chunks), 3)

    def chunks_with(self, cycle: int) -> list[Chunk]:
        """Return the chunks that hold messages of a cycle."""
        chunks = zip(self.run.outline.chunks, self._chunk_cycles, strict=False)
        return [chunk for chunk, cycles in chunks if cycle in cycles]

    def powers(self, cycles: range, points: int) -> dict[str, list[float]]:
        """Return the plant's powers [kW] of some cycles, thinned out to about `points` rows."""
        if not self.cycles:
            return {"cycle": []}
        begin, end = max(cycles.start, 0), min(cycles.stop, self.cycles)
        part = self._powers.series(self.plan.run_id).between(begin, end)
        unavoidable = np.maximum(part.desired_kw - part.available_kw, 0.0)
        columns = {
            "dispatch": part.desired_kw,
            "available": part.available_kw,
            "delivered": part.delivered_kw,
            "without_help": part.without_help_kw,
            "unavoidable": unavoidable,
        }
        rows = np.arange(part.cycles)
        if len(rows) > points:
            drawn = ("dispatch", "available", "delivered", "without_help")
            kept = [extremes(columns[name], max(points // 8, 1)) for name in drawn]
            rows = np.unique(np.concatenate(kept))
        thinned = {name: values[rows].round(2).tolist() for name, values in columns.items()}
        return {"cycle": (rows + begin).tolist()} | thinned

    def metrics(self, end: int) -> Figures | None:
        """Return the figures of merit up to a cycle, without it; None before the first one."""
        if not self.cycles:
            return None
        series = self._powers.series(self.plan.run_id).between(0, end)
        return run_figures(series) if series.known.any() else None

    def plants(self, end: int) -> Iterator[PlantFigures]:
        """Yield what each plant of a fleet gave up to a cycle, without it."""
        yield from plant_figures(self._powers.series(self.plan.run_id).between(0, end))

    def _next_chunk(self) -> Chunk | None:
        """Return the next chunk that is there as a whole."""
        outline, number = self.run.outline, len(self._chunk_cycles)
        return outline.chunks[number] if number < len(outline.chunks) else None

    def _read(self, chunk: Chunk) -> None:
        first, last = maxsize, -1
        for record in self.run.records_of(chunk):
            cycle = record.cycle
            first, last = min(first, cycle), max(last, cycle)
            self.states.see(record)
            if record.port.signal in _FOLLOWED:
                with suppress(*UNREADABLE):  # A device of the user's may send anything.
                    self._see(record.port, record.payload)
        if chunk in self.run.damage:
            self._note("damage", self.cycles, RECORDER, "a part of the file is damaged")
        self._chunk_cycles.append(range(first, last + 1))
        self._events = None

    def _note(self, kind: str, cycle: int, agent: str, text: str) -> None:
        self._noted.append(Change(kind, cycle, agent, text))
        self._events = None

    def _see(self, port: Port[Message], payload: bytes) -> None:
        message = port.signal.decode(payload)
        cycle = message.cycle
        match message:
            case Dispatch() | Meter():
                self._powers.see(port, message)
            case Production() if 0 <= cycle < self.plan.timing.cycles:
                self._powers.see(port, message)
                self.cycles = max(self.cycles, cycle + 1)
            case Notice():
                self._note("notice", cycle, message.source, message.text)
            case Run(state="start"):
                self._note("run", cycle, PLANT, "the run begins")
            case Run(state="stop"):
                self._stops.add(cycle)

    def _changes(self) -> Iterator[Change]:
        """Yield what is worked out from several messages."""
        yield from self.states.changes()
        dispatches = self._powers.orders.changes()
        for last, dispatch in pairwise([None, *dispatches]):
            if dispatch is not None and (event := order_event(dispatch, last)):
                yield Change("order", dispatch.cycle, *event)
        outcome = self._outcome._replace(failure="")
        if outcome.stop_cycle is not None:
            yield Change("run", outcome.stop_cycle, PLANT, f"the run is {outcome.kind}")


_FOLLOWED: Final = frozenset({DISPATCH, METER, PRODUCTION, NOTICE, RUN})
"""Signals of which each message is read."""
