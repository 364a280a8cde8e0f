"""Follows a recording chunk by chunk: to its end, and on while it is being written.

Of every cycle it keeps the plant's powers, of every chunk the cycles that it holds, and of what
happened the newest events. All else is read from the file when somebody looks at it: following a
run costs its agents nothing, however slow the reader is.
"""

from __future__ import annotations

import os
import time
from bisect import bisect_left, bisect_right
from collections import Counter, defaultdict
from contextlib import suppress
from math import ceil
from pathlib import Path
from typing import Final, Literal, TypeAlias

import msgspec
import numpy as np

from bus_schemas.codec import decode
from bus_schemas.messages import Dispatch, Message, Notice, Production, Run
from bus_schemas.signals import DISPATCH, IMPP, NOTICE, PRODUCTION, RUN, TELEMETRY, Port
from bus_schemas.tree import PLANT, RECORDER, agent_name
from live_page.event_log import EventLog
from recordings.inspect.health import FAILURE_NAME
from recordings.read.chunks import ChunkPlace
from recordings.read.gaps import PortGaps
from recordings.read.outline import walk_on
from recordings.read.reader import Head, RunReader, head_of
from recordings.read.series import RunSeries
from studies.metrics import RunMetrics, run_metrics
from studies.report.decimation import extremes

State: TypeAlias = Literal["waiting", "running", "silent", "over", "failed"]
"""Before the first cycle; going on; nothing new for a while; ended; given up by its launcher."""

_SILENT_S: Final = 5.0
"""Nothing new in the file for this long, or for three cycles, is worth saying."""

MOST_CHUNKS: Final = 20
"""To look at for the state in one cycle."""

_LATEST_S: Final = 1.0
"""So late a message may come in real time and still be found. In lockstep it may come among those
of the next cycle."""


class RunFollower:
    """A recording, as far as it has been read.

    `cycles` are those that the plant has completed, `restarts` says how often each agent began
    again. `start_time_ns` is that of the run on its own clock, None until it is recorded.
    """

    def __init__(self, path: Path) -> None:
        self.run = RunReader(path, skip_damaged=True)
        self.plan = self.run.plan
        self.cycles = 0
        self.events = EventLog()
        self.restarts: Counter[str] = Counter()
        self.start_time_ns: int | None = None
        self._stop_cycle: int | None = None
        self._failed = False
        wall_s = self.plan.cycle_wall_ns / 1e9
        self._disorder = ceil(_LATEST_S / wall_s) if wall_s else 1
        self._firsts: list[int] = []
        self._gaps: defaultdict[Port[Message], PortGaps] = defaultdict(PortGaps)
        # Each node states its IMPP in each cycle; a real inverter that is gone has no telemetry.
        self._names: dict[Port[Message], str] = {
            **{IMPP.of(node): agent_name(node) for node in self.plan.tree.nodes},
            **{TELEMETRY.of(node): f"device {node}" for node, _ in self.plan.devices},
        }
        self._heard = dict.fromkeys(self._names, -1)
        self._silent: set[Port[Message]] = set()
        # One column stands for all inverters: figures of merit need no more.
        shape = (self.plan.cycles, 1)
        self._series = RunSeries.of(
            self.plan,
            self.plan.run_id,
            commitment_kw=np.full(self.plan.cycles, np.nan),
            regulation_kw=np.full(self.plan.cycles, np.nan),
            mpp_kw=np.full(shape, np.nan),
            power_kw=np.full(shape, np.nan),
        )
        for rule in self.plan.faults:
            self.events.add("fault", 0, "network", f"fault rule: {rule}")

    def advance(self, budget_s: float) -> bool:
        """Read on for a while; return whether all that is in the file has been read."""
        outline = self.run.outline
        if not outline.closed and self._next_chunk() is None:
            self.run.join()
            walk_on(outline, self.run.files[-1])
        until = time.monotonic() + budget_s
        while (place := self._next_chunk()) is not None:
            self._read(place)
            if time.monotonic() >= until:
                break
        self._look_for_failure()
        return self._next_chunk() is None

    def close(self) -> None:
        self.run.close()

    @property
    def state(self) -> State:
        if self._failed:
            return "failed"
        if self.run.outline.closed or self._stop_cycle is not None:
            return "over"
        if not self.cycles:
            return "waiting"
        longest_s = max(_SILENT_S, 3.0 * self.plan.cycle_wall_ns / 1e9)
        age_s = time.time() - os.fstat(self.run.files[-1].fileno()).st_mtime
        return "silent" if age_s > longest_s else "running"

    @property
    def read_share(self) -> float | None:
        """Share of the file's chunks that has been read; None: all of them."""
        if self._next_chunk() is None:
            return None
        return round(len(self._firsts) / len(self.run.outline.chunks), 3)

    def chunks_with(self, cycle: int, before: int = 1) -> list[ChunkPlace]:
        """Return the chunks that can hold messages of a cycle and of some cycles before it."""
        begin = bisect_left(self._firsts, cycle - before - self._disorder) - 1
        end = bisect_right(self._firsts, cycle + self._disorder)
        return self.run.outline.chunks[max(begin, end - MOST_CHUNKS, 0) : end]

    def powers(self, cycles: range, points: int) -> dict[str, list[float]]:
        """Return the plant's powers [kW] of some cycles, thinned out to about so many points."""
        begin, end = max(cycles.start, 0), min(cycles.stop, self.cycles)
        part = self._series.between(begin, end)
        unavoidable = np.maximum(part.desired_kw - part.possible_kw, 0.0)
        columns = {
            "desired": part.desired_kw,
            "possible": part.possible_kw,
            "delivered": part.delivered_kw,
            "unavoidable": unavoidable,
            "control_caused": np.maximum(part.support_kw - unavoidable, 0.0),
        }
        rows = np.arange(part.cycles)
        if len(rows) > points:
            drawn = ("desired", "possible", "delivered")
            kept = [extremes(columns[name], max(points // 6, 1)) for name in drawn]
            rows = np.unique(np.concatenate(kept))
        thinned = {name: values[rows].round(2).tolist() for name, values in columns.items()}
        return {"cycle": (rows + begin).tolist()} | thinned

    def metrics(self) -> RunMetrics | None:
        """Return the figures of merit so far; None before the first cycle."""
        series = self._series.between(0, self.cycles)
        return run_metrics(series) if series.known.any() else None

    def _next_chunk(self) -> ChunkPlace | None:
        """Return the next chunk that is there as a whole."""
        outline, number = self.run.outline, len(self._firsts)
        return outline.chunks[number] if number < len(outline.chunks) else None

    def _read(self, place: ChunkPlace) -> None:
        ports = self.run.channels
        begin: Head | None = None
        for channel, sequence, _, _, payload in self.run.messages_of(place, ports):
            port = ports[channel]
            with suppress(msgspec.DecodeError):  # A device of the user's may send anything.
                head = head_of(payload)
                begin = begin or head
                self._count(port, sequence, head)
                if port in self._names:
                    self._hear(port, head.cycle)
                elif port.signal in _FOLLOWED:
                    self._see(port, payload)
        if place in self.run.damage:
            self.events.add("damage", self.cycles, RECORDER, "a part of the file is damaged")
        first = min(begin.cycle, head.cycle) if begin else self.cycles - 1
        self._firsts.append(max(first, self._firsts[-1] if self._firsts else 0))
        if self._stop_cycle is not None and self._stop_cycle < self.cycles:
            text = f"a message said that it was over after {self._stop_cycle:,} cycles"
            self.events.add("run", self._stop_cycle, PLANT, f"the run goes on, although {text}")
            self._stop_cycle = None
        self._note_silence()

    def _see(self, port: Port[Message], payload: bytes) -> None:
        message = decode(port.signal, payload)
        cycle = message.cycle
        match message:
            case Dispatch() if 0 <= cycle < self.plan.cycles:
                self._series.commitment_kw[cycle] = message.commitment_kw
                self._series.regulation_kw[cycle] = message.regulation_kw
            case Production() if 0 <= cycle < self.plan.cycles:
                self._series.mpp_kw[cycle] = message.possible_kw
                self._series.power_kw[cycle] = message.delivered_kw
                self.cycles = max(self.cycles, cycle + 1)
            case Notice():
                self.events.add("notice", cycle, message.source, message.text)
            case Run(state="start"):
                self.start_time_ns = message.start_time_ns
                pace = "in real time" if message.cycle_wall_ns else "in lockstep"
                self.events.add("run", cycle, PLANT, f"the run begins, {pace}")
            case Run(state="stop"):
                self._stop_cycle = cycle
                self.events.add("run", cycle, PLANT, f"the run is over after {cycle:,} cycles")

    def _hear(self, port: Port[Message], cycle: int) -> None:
        """Note a message that comes in each cycle."""
        before, name = self._heard[port], self._names[port]
        if port in self._silent:
            self._silent.discard(port)
            self.events.add("back", cycle, name, "heard again")
        elif cycle > before + 1 + self.plan.hold_cycles and before >= 0:
            self.events.add("silent", before + 1, name, f"silent up to cycle {cycle - 1:,}")
        self._heard[port] = max(cycle, before)

    def _note_silence(self) -> None:
        for port, cycle in self._heard.items():
            if self.cycles - 1 > cycle + self.plan.hold_cycles and port not in self._silent:
                self._silent.add(port)
                self.events.add("silent", cycle + 1, self._names[port], "silent")

    def _count(self, port: Port[Message], sequence: int, head: Head) -> None:
        """Count lost messages and restarts by a message's number on its key."""
        gaps = self._gaps[port]
        lost, restarts = gaps.lost, gaps.restarts
        gaps.see(head.cycle, sequence, head.incarnation)
        if gaps.restarts > restarts and port.signal is IMPP:
            self.restarts[port.publisher] += 1
            self.events.add("restart", head.cycle, port.publisher, "restarted")
        if gaps.lost > lost:
            self.events.add("lost", head.cycle, port.publisher, "messages lost", gaps.lost - lost)

    def _look_for_failure(self) -> None:
        failure = self.run.path.parent / FAILURE_NAME
        if not self._failed and failure.exists():
            self._failed = True
            text = failure.read_text(encoding="utf-8", errors="replace").partition("\n")[0]
            self.events.add("failure", self.cycles, "launcher", text)


_FOLLOWED: Final = frozenset({DISPATCH, PRODUCTION, NOTICE, RUN})
"""Signals of which each message is read."""
