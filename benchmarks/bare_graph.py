"""The messages of one cycle over and over, without any control: what the machine and Zenoh can do.

    python benchmarks/bare_graph.py GRAPH.json --cycles 800

GRAPH.json names each process with the keys that it hears and its stages: the keys that a stage
awaits, one message of each, and the messages that it then puts. `cycle_rate.py` derives it from a
recording. Sessions are set up as Heliarch's, and processes are forked from one parent that has
imported everything. They act on the thread on which Zenoh calls them; a recorder hears everything
and writes the payloads to an MCAP file unread. Nobody decodes, checks or computes anything.

Prints one JSON document, as `harness.run_script` reads it.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import itertools
import json
import multiprocessing
import os
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from statistics import median
from typing import Any, Final

import msgspec
import psutil
import zenoh
from mcap.writer import CompressionType, Writer

from agents.process.machine import die_with_parent
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import RECORDER
from bus_schemas.wiring import Links
from bus_schemas.zenoh_session import (
    QUEUE_LENGTH,
    ZENOH_RUNTIME,
    SessionSettings,
    TokenWatch,
    open_session,
)

WARM_UP: Final = 50
ARM_LIMIT_S: Final = 60.0
STALL_S: Final = 10.0
RUN_LIMIT_S: Final = 300.0
NAP_S: Final = 0.002
FLUSH_S: Final = 0.5


class Put(msgspec.Struct, frozen=True):
    """One message of each cycle; its payload is bytes, in JSON in base 64."""

    key: str
    payload: bytes


class Stage(msgspec.Struct, frozen=True):
    """What a process waits for, and what it then puts."""

    awaits: list[str]
    puts: list[Put]


class Process(msgspec.Struct, frozen=True):
    """A process of the graph. Of two that are linked the one listed first listens."""

    name: str
    hears: list[str]
    stages: list[Stage]

    def says(self) -> list[str]:
        return [put.key for stage in self.stages for put in stage.puts]


Graph = list[Process]
"""All processes, the recorder excepted. The first one begins each cycle."""


def links_of(graph: Graph) -> Links:
    """Return a link for each pair of which one puts what the other hears."""
    pairs = [(RECORDER, process.name) for process in graph]
    for one, other in itertools.combinations(graph, 2):
        if {*one.says()} & {*other.hears} or {*other.says()} & {*one.hears}:
            pairs.append((one.name, other.name))
    return Links(tuple(pairs))


def says(graph: Graph) -> list[str]:
    return [key for process in graph for key in process.says()]


Work = Callable[[], object]
THREAD: Final = threading.local()


class Player:
    """A process of the graph: Zenoh's thread puts as soon as it brings what a stage lacks."""

    def __init__(self, process: Process, cycles: int, session: zenoh.Session) -> None:
        self._cycle, self._cycles = -WARM_UP, cycles
        self._lock = threading.Lock()
        self._is_over = threading.Event()
        self._surplus: Counter[str] = Counter()
        self._began = self._ended = 0.0
        block = zenoh.CongestionControl.BLOCK
        self._stages = [
            (
                stage.awaits,
                [
                    partial(
                        session.declare_publisher(put.key, congestion_control=block).put,
                        put.payload,
                    )
                    for put in stage.puts
                ],
            )
            for stage in process.stages
        ]
        self._place = 0
        self._missing = self._claim()
        self._kept = [
            session.declare_subscriber(
                key, zenoh.handlers.Callback(partial(self._hear, key), indirect=False)
            )
            for key in process.hears
        ]

    def __call__(self) -> tuple[float, float]:
        """Begin, if this is the process that begins each cycle; return when all began and ended."""
        with self._lock:
            self._advance()
        self._is_over.wait()
        return self._began, self._ended

    def _hear(self, key: str, _sample: zenoh.Sample) -> None:
        if not hasattr(THREAD, "is_kept"):  # Python would set up a thread state for each callback.
            ctypes.pythonapi.PyGILState_Ensure()
            THREAD.is_kept = True
        with self._lock:
            self._surplus[key] += 1
            if self._surplus[key] == 0:
                self._missing -= 1
                self._advance()

    def _claim(self) -> int:
        """Take what the open stage awaits; return how much of it has yet to come."""
        awaits, _ = self._stages[self._place]
        for key in awaits:
            self._surplus[key] -= 1
        return sum(self._surplus[key] < 0 for key in awaits)

    def _advance(self) -> None:
        while not self._missing and self._cycle < self._cycles:
            for put in self._stages[self._place][1]:
                put()
            self._place = (self._place + 1) % len(self._stages)
            if self._place == 0:
                self._end_cycle()
            self._missing = self._claim()

    def _end_cycle(self) -> None:
        self._cycle += 1
        if self._cycle == 0:
            self._began = time.monotonic()
        elif self._cycle == self._cycles:
            self._ended = time.monotonic()
            self._is_over.set()


def recorder(graph: Graph, cycles: int, session: zenoh.Session) -> Work:
    """Return what the recorder does: write and count payloads until nothing more comes."""
    subscriber = session.declare_subscriber("**", zenoh.handlers.FifoChannel(QUEUE_LENGTH))
    keys = says(graph)

    def record() -> int:
        written = 0
        with tempfile.TemporaryFile() as file:
            writer = Writer(file, compression=CompressionType.LZ4)
            writer.start(profile="bare", library="bare graph")
            schema = writer.register_schema("bare", "", b"")
            channels = {key: writer.register_channel(key, "msgpack", schema) for key in keys}
            heard = flushed = now = time.monotonic()
            while written < len(keys) * (WARM_UP + cycles) and now - heard < STALL_S:
                while (sample := subscriber.try_recv()) is not None:
                    now_ns, data = time.time_ns(), sample.payload.to_bytes()
                    channel = channels[str(sample.key_expr)]
                    writer.add_message(channel, now_ns, data, now_ns, written)
                    written, heard = written + 1, now
                if now - flushed > FLUSH_S:
                    writer.flush()
                    flushed = now
                time.sleep(NAP_S)
                now = time.monotonic()
            writer.finish()
        return written

    return record


def live(
    settings: SessionSettings, name: str, role: Callable[[zenoh.Session], Work], parent: Any
) -> None:
    """Be one process of the graph, from its fork on."""
    die_with_parent()
    gc.disable()
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    session = open_session(settings)
    work = role(session)
    _token = session.liveliness().declare_token(f"alive/{name}")  # It follows the subscriptions.
    tokens = TokenWatch("alive/**", [session])
    partners = {f"alive/{peer}" for peer in settings.peers}
    while not partners <= tokens.alive():
        time.sleep(0.05)
    parent.send("armed")
    parent.recv()
    parent.send(work())
    parent.recv()  # Its session stays open until the parent has heard from everybody.


def hear(child: Connection, process: BaseProcess, limit_s: float) -> Any:
    if child not in wait([child, process.sentinel], limit_s):
        raise RuntimeError(f"{process.name} failed or hangs")
    return child.recv()


def end(process: BaseProcess) -> None:
    process.kill()
    process.join()


def run(graph: Graph, cycles: int) -> dict[str, object]:
    os.environ["ZENOH_RUNTIME"] = ZENOH_RUNTIME
    links = links_of(graph)
    roles: dict[str, Callable[[zenoh.Session], Work]]
    roles = {each.name: partial(Player, each, cycles) for each in graph}
    roles[RECORDER] = partial(recorder, graph, cycles)
    gc.collect()
    gc.freeze()
    fork = multiprocessing.get_context("fork")
    children: list[tuple[Connection, BaseProcess]] = []
    with ExitStack() as stack:
        ports = stack.enter_context(reserved_ports(links.listening))
        for name, role in roles.items():
            child, parent = fork.Pipe()
            ends = links.endpoints(name, lambda one: f"tcp/127.0.0.1:{ports[one]}")
            peers = links.peers(name)
            settings = SessionSettings("bare", *ends, peers=peers)
            process = fork.Process(target=live, args=(settings, name, role, parent), name=name)
            stack.callback(end, process)
            process.start()
            children.append((child, process))
        for each in children:
            hear(*each, ARM_LIMIT_S)
        for child, _ in reversed(children):
            child.send("go")
        (began, ended), *_, written = [hear(*each, RUN_LIMIT_S) for each in children]
        *own, _ = [psutil.Process(each.pid).memory_full_info().uss / 1e6 for _, each in children]
    messages = len(says(graph)) * (WARM_UP + cycles)
    counts = {"cycles": cycles, "lost": messages - written}
    return {"began": began, "ended": ended, **counts, "own_mb": median(own)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("graph", type=Path)
    parser.add_argument("--cycles", type=int, default=800)
    options = parser.parse_args()
    graph = msgspec.json.decode(options.graph.read_bytes(), type=Graph)
    print(json.dumps(run(graph, options.cycles)))


if __name__ == "__main__":
    main()
