"""The messages of one cycle over and over, without any control: what the machine and Zenoh can do.

    python benchmarks/bare_graph.py GRAPH.json --cycles 800

GRAPH.json names each process with the keys that it hears and its stages: the keys that a stage
awaits, one message of each, and the messages that it then puts. `cycle_rate.py` derives it from a
recording. Nothing of Heliarch is imported here. Processes are forked from one parent that has
imported everything and runs one thread; they act on the thread on which Zenoh calls them; two are
linked, by TCP on 127.0.0.1, if one puts what the other hears; a recorder hears everything and
writes the payloads to an MCAP file unread. Nobody decodes, checks or computes anything.

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
import socket
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
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

RECORDER: Final = "recorder"
WARM_UP: Final = 50
ARM_LIMIT_S: Final = 60.0
STALL_S: Final = 10.0
RUN_LIMIT_S: Final = 300.0
NAP_S: Final = 0.002
FLUSH_S: Final = 0.5
RUNTIME: Final = (
    "(rx: (handover: app), acc: (handover: app), tx: (handover: app), net: (handover: app), "
    "app: (worker_threads: 1))"
)
SESSION: Final = {
    "mode": "peer",
    "connect/timeout_ms": -1,
    "connect/exit_on_failure": False,
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/shared_memory/enabled": False,
}


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


class Network:
    """Who links with whom, and through which ports."""

    def __init__(self, graph: Graph) -> None:
        pairs = [(RECORDER, process.name) for process in graph]
        for one, other in itertools.combinations(graph, 2):
            if {*one.says()} & {*other.hears} or {*other.says()} & {*one.hears}:
                pairs.append((one.name, other.name))
        self._pairs = pairs
        sockets = {listener: socket.create_server(("127.0.0.1", 0)) for listener, _ in pairs}
        self._ports = {name: each.getsockname()[1] for name, each in sockets.items()}
        for each in sockets.values():
            each.close()

    def open(self, name: str) -> zenoh.Session:
        listens = [name] if name in self._ports else []
        connects = [listener for listener, caller in self._pairs if caller == name]
        config = zenoh.Config()
        for key, value in SESSION.items():
            config.insert_json5(key, json.dumps(value))
        for key, names in (("listen/endpoints", listens), ("connect/endpoints", connects)):
            addresses = [f"tcp/127.0.0.1:{self._ports[each]}" for each in names]
            config.insert_json5(key, json.dumps(addresses))
        return zenoh.open(config)

    def arm(self, name: str, session: zenoh.Session) -> zenoh.LivelinessToken:
        """Wait until all partners are seen; a token follows its owner's subscriptions."""
        token = session.liveliness().declare_token(f"alive/{name}")
        partners = {each for pair in self._pairs if name in pair for each in pair} - {name}
        wanted = {f"alive/{partner}" for partner in partners}
        while wanted:
            for reply in session.liveliness().get("alive/**"):
                wanted.discard(str(reply.ok.key_expr) if reply.ok else "")
            time.sleep(0.05)
        return token


def says(graph: Graph) -> list[str]:
    return [key for process in graph for key in process.says()]


Work = Callable[[], object]
THREAD: Final = threading.local()


def subscribe(session: zenoh.Session, key: str, act: Callable[[str], None]) -> object:
    def hear(_sample: zenoh.Sample) -> None:
        if not hasattr(THREAD, "is_kept"):  # Python would set up a thread state for each callback.
            ctypes.pythonapi.PyGILState_Ensure()
            THREAD.is_kept = True
        act(key)

    return session.declare_subscriber(key, zenoh.handlers.Callback(hear, indirect=False))


def declare(session: zenoh.Session, key: str) -> Callable[[bytes], None]:
    block, reliable = zenoh.CongestionControl.BLOCK, zenoh.Reliability.RELIABLE
    return session.declare_publisher(key, congestion_control=block, reliability=reliable).put


class Player:
    """A process of the graph: Zenoh's thread puts as soon as it brings what a stage lacks."""

    def __init__(self, process: Process, cycles: int, session: zenoh.Session) -> None:
        self._cycle, self._cycles = -WARM_UP, cycles
        self._lock = threading.Lock()
        self._is_over = threading.Event()
        self._surplus: Counter[str] = Counter()
        self._began = self._ended = 0.0
        self._stages = [
            (stage.awaits, [(declare(session, put.key), put.payload) for put in stage.puts])
            for stage in process.stages
        ]
        self._place = 0
        self._missing = self._claim()
        self._kept = [subscribe(session, key, self._hear) for key in process.hears]

    def __call__(self) -> tuple[float, float]:
        """Begin, if this is the process that begins each cycle; return when all began and ended."""
        with self._lock:
            self._advance()
        self._is_over.wait()
        return self._began, self._ended

    def _hear(self, key: str) -> None:
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
            for put, payload in self._stages[self._place][1]:
                put(payload)
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
    subscriber = session.declare_subscriber("**", zenoh.handlers.FifoChannel(65536))
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


def live(network: Network, name: str, role: Callable[[zenoh.Session], Work], parent: Any) -> None:
    """Be one process of the graph, from its fork on."""
    die_with_parent()
    gc.disable()
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    session = network.open(name)
    work = role(session)
    _token = network.arm(name, session)
    parent.send("armed")
    parent.recv()
    parent.send(work())
    parent.recv()  # Its session stays open until the parent has heard from everybody.


def hear(child: Connection, process: BaseProcess, limit_s: float) -> Any:
    if child not in wait([child, process.sentinel], limit_s):
        raise RuntimeError(f"{process.name} failed or hangs")
    return child.recv()


def run(graph: Graph, cycles: int) -> dict[str, object]:
    os.environ["ZENOH_RUNTIME"] = RUNTIME
    network = Network(graph)
    roles: dict[str, Callable[[zenoh.Session], Work]]
    roles = {each.name: partial(Player, each, cycles) for each in graph}
    roles[RECORDER] = partial(recorder, graph, cycles)
    gc.collect()
    gc.freeze()
    fork = multiprocessing.get_context("fork")
    children: list[tuple[Connection, BaseProcess]] = []
    try:
        for name, role in roles.items():
            child, parent = fork.Pipe()
            process = fork.Process(target=live, args=(network, name, role, parent), name=name)
            process.start()
            children.append((child, process))
        for each in children:
            hear(*each, ARM_LIMIT_S)
        for child, _ in reversed(children):
            child.send("go")
        (began, ended), *_, written = [hear(*each, RUN_LIMIT_S) for each in children]
        *own, _ = [psutil.Process(each.pid).memory_full_info().uss / 1e6 for _, each in children]
    finally:
        for _, started in children:
            started.kill()
            started.join()
    messages = len(says(graph)) * (WARM_UP + cycles)
    counts = {"cycles": cycles, "messages": messages, "lost": messages - written}
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
