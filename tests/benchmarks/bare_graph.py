"""The control graph of a plan without any control: what the machine and Zenoh alone can do.

The same processes as `heliarch launch` starts, the same links, keys and subscriptions, and in each
cycle the same messages as in one cycle of the real run, byte for byte, but always the same ones.
No codec, no sequencer, no agents: a process waits for as many messages as the real agent's stage
needs, and puts what the real agent put. The recorder writes each payload to an MCAP file unread.

    python tests/benchmarks/bare_graph.py --topology mesh --cycles 500
"""

# The processes of the graph run this file too, and must not wait for pandas and pvlib.
# ruff: noqa: PLC0415

from __future__ import annotations

import argparse
import os
import selectors
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Generic, Literal, TypeAlias, TypeVar, get_args

import msgspec
import zenoh

from agents.agent import Agent, Stage, Turn
from agents.events import Event, Failed, Joined
from agents.garbage import spare_the_collector
from agents.lifeline import Lifeline
from agents.plan import RunPlan
from agents.process_setup import join_run
from bus_schemas.bus import Delivery
from bus_schemas.codec import encode
from bus_schemas.links import Links, explicit_links
from bus_schemas.messages import Message
from bus_schemas.signals import RUN, Port, listeners, ports
from bus_schemas.tree import PLANT, RECORDER, ROOT
from bus_schemas.zenoh_bus import ENCODING, Inbox, SessionSettings
from launch_scripts.processes import environment
from launch_scripts.tcp_ports import reserved_ports

S = TypeVar("S")

Topology: TypeAlias = Literal["explicit", "mesh", "router"]

ARM_S: Final = 20.0
"""How long the processes may take to see each other."""

ROUTER: Final = "router"
_WARM_UP: Final = 50
_STALL_S: Final = 5.0
_QUIET_S: Final = 2.0
_FLUSH_S: Final = 0.5
_NAP_S: Final = 0.005
_TAP_CAPACITY: Final = 65536
_NUMBER_BYTES: Final = 4


class BareFailure(Exception):  # noqa: N818 - what failed is the run, not the program
    """A bare run that could not go on, and why."""


# What the graph is ------------------------------------------------------------------------------


class Put(msgspec.Struct, frozen=True):
    """One message of each cycle."""

    key: str
    payload: bytes


class Step(msgspec.Struct, frozen=True):
    """What is left of a stage: how many messages it needs, and those that it then sends."""

    wanted: int
    puts: tuple[Put, ...]


class Graph(msgspec.Struct, frozen=True):
    """The messages of one cycle of a plan, agent by agent and stage by stage."""

    plan: RunPlan
    steps: dict[str, tuple[Step, ...]]

    @property
    def messages(self) -> int:
        """Messages in a cycle."""
        return sum(len(step.puts) for steps in self.steps.values() for step in steps)

    @property
    def payload_bytes(self) -> int:
        """Bytes of payload in a cycle."""
        puts = (put for steps in self.steps.values() for step in steps for put in step.puts)
        return sum(len(put.payload) for put in puts)


class Variant(msgspec.Struct, frozen=True):
    """How the graph is run. The defaults are what the project does.

    Attributes
    ----------
    one_thread
        Whether agents get the project's ZENOH_RUNTIME. A router never does: it hangs under it.
    express
        Whether each message goes out by itself instead of in a batch with others.
    indirect
        Whether a thread of Python's stands between Zenoh and the inbox.
    wake_per_message
        Whether an agent is woken by each message instead of once for each stage.
    rate_hz
        Cycles per second in real time, with messages that may be dropped. 0: lockstep.
    patience_us
        In real time: how long a message may wait for room before it is dropped.
    """

    name: str = "explicit links"
    topology: Topology = "explicit"
    recorder: bool = True
    one_thread: bool = True
    express: bool = False
    indirect: bool = True
    wake_per_message: bool = False
    rate_hz: float = 0.0
    patience_us: int = 20_000


class Job(msgspec.Struct, frozen=True):
    """What the processes of one bare run must know. `sees` lists those that each talks with."""

    graph: Graph
    variant: Variant
    cycles: int
    settings: dict[str, SessionSettings]
    sees: dict[str, tuple[str, ...]]


class Spy(Generic[S]):
    """An agent that notes what it needed and sent in each stage."""

    def __init__(self, agent: Agent[S]) -> None:
        self.name = agent.name
        self.initial_state = agent.initial_state
        self.follow_up = agent.follow_up
        self.notes: dict[int, list[tuple[int, list[Delivery]]]] = {}
        self._agent = agent

    def stages(self, cycle: int) -> tuple[Stage, ...]:
        return self._agent.stages(cycle)

    def step(self, state: S, turn: Turn) -> tuple[S, list[Delivery]]:
        state, outputs = self._agent.step(state, turn)
        notes = self.notes.setdefault(turn.cycle, [])
        notes.append((len(turn.inputs) - sum(wanted for wanted, _ in notes), outputs))
        return state, outputs

    def sent(self, cycle: int) -> int:
        return sum(len(outputs) for _, outputs in self.notes[cycle])


def graph_of(scenario: str, cycles: int) -> Graph:
    """Run a scenario in memory; return the cycle whose number of messages is nearest the mean."""
    from launch_scripts.preparation import RunOptions, prepare
    from launch_scripts.scenario import load_scenario
    from launch_scripts.simulation import MemoryRun

    # Cycles are of one second in the scenarios that come with the project.
    preparation = prepare(load_scenario(scenario), RunOptions(None, f"{cycles}s", "max"), "bare")
    plan = preparation.plan
    if plan.periods.longest > 1:
        raise BareFailure(f"{scenario}: its tiers do not all act in each cycle, accepted is 1")
    run = MemoryRun(plan, preparation.profile)
    spies = {name: Spy(sequencer.agent) for name, sequencer in run.sequencers.items()}
    for name, sequencer in run.sequencers.items():
        sequencer.agent = spies[name]
    for _ in run.cycles():
        pass
    sent = [sum(spy.sent(cycle) for spy in spies.values()) for cycle in range(plan.cycles)]
    mean = sum(sent) / len(sent)
    typical = min(range(plan.cycles), key=lambda cycle: abs(sent[cycle] - mean))
    steps = {
        name: tuple(
            Step(wanted, tuple(_put(plan, port, message) for port, message in outputs))
            for wanted, outputs in spy.notes[typical]
        )
        for name, spy in spies.items()
    }
    return Graph(plan, steps)


def _put(plan: RunPlan, port: Port[Message], message: Message) -> Put:
    stamped = msgspec.structs.replace(
        message, publish_time_ns=time.monotonic_ns(), sequence=message.cycle
    )
    return Put(plan.keys.key(port), encode(stamped))


# The processes of the graph ---------------------------------------------------------------------


class Absent(Event, frozen=True):
    """The agents that this one does not see."""

    agents: list[str]


class Done(Event, frozen=True):
    """The account of a process.

    Attributes
    ----------
    sent, written
        Messages put, and messages that a recorder wrote down.
    began_ns, ended_ns
        The plant's: monotonic time of the cycles that count.
    unfinished
        The plant's: cycles that lost messages kept from closing.
    cpu_s
        Processor time, warm-up included.
    """

    sent: int = 0
    written: int = 0
    began_ns: int = 0
    ended_ns: int = 0
    unfinished: int = 0
    cpu_s: float = 0.0


AnyEvent: TypeAlias = Joined | Failed | Absent | Done


class Player:
    """One agent of the graph: waits, puts, waits.

    Parameters
    ----------
    job, agent
        The run, and which of its agents this is.
    session
        Its own.
    """

    def __init__(self, job: Job, agent: str, session: zenoh.Session) -> None:
        self.sent = 0
        self.over = False
        self.unfinished = 0
        self._job = job
        # In real time messages get lost, so each carries its cycle in its first bytes; a cycle
        # that lost one ends where it is, and the next one begins with its own first message.
        self._number = -1
        self._place = 0
        self._have = 0
        self._inbox = Inbox()
        plan = job.graph.plan
        self._end_key = plan.keys.key(RUN.of(ROOT))
        self._session = session
        self._steps = [
            (step.wanted, [(self._declare(put.key).put, put.payload) for put in step.puts])
            for step in job.graph.steps[agent]
        ]
        self._subscribers = [self._subscribe(key) for key in _subscriptions(agent, plan)]
        self._token = session.liveliness().declare_token(plan.keys.alive_key(agent))

    def follow(self) -> Done:
        """Play until the plant says that it is over."""
        if self._job.variant.rate_hz:
            while not self.over:
                self._hear(10 * _STALL_S)
        else:
            while self._cycle():
                pass
        return Done(self.sent)

    def lead(self) -> Done:
        """Play the plant: pace the cycles, and end them."""
        rate_hz = self._job.variant.rate_hz
        lead = self._lead_in_time if rate_hz else self._lead_in_lockstep
        began_ns, ended_ns = lead()
        self._declare(self._end_key).put(b"stop")
        return Done(self.sent + 1, began_ns=began_ns, ended_ns=ended_ns, unfinished=self.unfinished)

    def _lead_in_lockstep(self) -> tuple[int, int]:
        for _ in range(_WARM_UP):
            self._cycle()
        began_ns = time.monotonic_ns()
        for _ in range(self._job.cycles):
            self._cycle()
        return began_ns, time.monotonic_ns()

    def _cycle(self) -> bool:
        for wanted, puts in self._steps:
            if not self._collect(wanted):
                return False
            for put, payload in puts:
                put(payload)
            self.sent += len(puts)
        return True

    def _collect(self, wanted: int) -> bool:
        have = 0
        while have < wanted:
            at_once = 1 if self._job.variant.wake_per_message else wanted - have
            # Before its first message an agent waits for as long as the others may take to arm.
            heard = len(self._inbox.take(at_once, _STALL_S if self.sent else 2 * ARM_S))
            if self.over:
                return False
            if not heard:
                raise BareFailure(f"has {have} of {wanted} messages, {self.sent} were sent so far")
            have += heard
        return True

    def _lead_in_time(self) -> tuple[int, int]:
        period_s = 1.0 / self._job.variant.rate_hz
        began = time.monotonic()
        for number in range(self._job.cycles):
            self._advance(number)
            while (left_s := began + (number + 1) * period_s - time.monotonic()) > 0.0:
                self._hear(left_s)
            self.unfinished += self._place < len(self._steps)
        return round(began * 1e9), time.monotonic_ns()

    def _hear(self, timeout_s: float) -> None:
        for _, sample in self._inbox.take(1, timeout_s):
            number = int.from_bytes(sample.payload.to_bytes()[:_NUMBER_BYTES])
            if not self.over and number >= self._number:
                self._have += number == self._number
                self._advance(number)

    def _advance(self, number: int) -> None:
        if number > self._number:
            self._number, self._place = number, 0
            self._have = 1 if self._steps[0][0] else 0
        head = number.to_bytes(_NUMBER_BYTES)
        while self._place < len(self._steps) and self._have >= self._steps[self._place][0]:
            wanted, puts = self._steps[self._place]
            self._have -= wanted
            self._place += 1
            for put, payload in puts:
                put(head + payload[_NUMBER_BYTES:])
            self.sent += len(puts)

    def _declare(self, key: str) -> zenoh.Publisher:
        in_lockstep = not self._job.variant.rate_hz or key == self._end_key
        return self._session.declare_publisher(
            key,
            encoding=ENCODING,
            congestion_control=(
                zenoh.CongestionControl.BLOCK if in_lockstep else zenoh.CongestionControl.DROP
            ),
            reliability=zenoh.Reliability.RELIABLE,
            express=self._job.variant.express,
        )

    def _subscribe(self, key: str) -> zenoh.Subscriber[None]:
        hear = self._hear_end if key == self._end_key else self._inbox.put
        return self._session.declare_subscriber(
            key,
            zenoh.handlers.Callback(hear, indirect=self._job.variant.indirect),
            allowed_origin=zenoh.Locality.REMOTE,
        )

    def _hear_end(self, sample: zenoh.Sample) -> None:
        self.over = True
        self._inbox.put_urgent(sample)


class Tap:
    """The recorder of the graph: like the real one it drains a queue, but it reads nothing."""

    def __init__(self, job: Job, session: zenoh.Session, path: Path, words: list[str]) -> None:
        self._path = path
        self._words = words
        keys = job.graph.plan.keys
        self._keys = [keys.key(port) for port in keys.ports]
        self._subscriber = session.declare_subscriber(
            f"{keys.plant}/**",
            zenoh.handlers.FifoChannel(_TAP_CAPACITY),
            allowed_origin=zenoh.Locality.REMOTE,
        )
        self._token = session.liveliness().declare_token(keys.alive_key(RECORDER))

    def record(self) -> Done:
        """Write until all that the launching process says there is has come, or nothing more."""
        from mcap.writer import CompressionType, Writer

        with self._path.open("wb") as file:
            writer = Writer(file, compression=CompressionType.LZ4)
            writer.start(profile="bare", library="bare graph")
            schema = writer.register_schema("bare", "", b"")
            channels = {key: writer.register_channel(key, "msgpack", schema) for key in self._keys}
            written = 0
            flush_at = heard_at = time.monotonic()
            while not self._complete(written, time.monotonic() - heard_at):
                before = written
                while (sample := self._subscriber.try_recv()) is not None:
                    now_ns = time.monotonic_ns()
                    writer.add_message(
                        channel_id=channels[str(sample.key_expr)],
                        log_time=now_ns,
                        publish_time=now_ns,
                        sequence=written,
                        data=sample.payload.to_bytes(),
                    )
                    written += 1
                now = time.monotonic()
                if written > before:
                    heard_at = now
                else:
                    time.sleep(_NAP_S)
                if now >= flush_at:
                    writer.flush()
                    flush_at = now + _FLUSH_S
            writer.finish()
        return Done(written=written)

    def _complete(self, written: int, quiet_s: float) -> bool:
        if not self._words:
            return False
        return written >= int(self._words[0]) or quiet_s > _QUIET_S


def _subscriptions(agent: str, plan: RunPlan) -> list[str]:
    """Key expressions of an agent, as the project's bus has them: its own node, or all siblings."""
    expressions = []
    for port in ports(plan.tree):
        if agent in listeners(port, plan.tree):
            key = plan.keys.key(port)
            if port.node and port.node != agent:
                head, _, signal_name = key.rpartition("/")
                key = f"{head.rpartition('/')[0]}/*/{signal_name}"
            expressions.append(key)
    return list(dict.fromkeys(expressions))


def play(job_file: Path, agent: str) -> int:
    """Be one process of the graph. Returns the exit status."""
    join_run(attached=True)
    job = msgspec.json.decode(job_file.read_bytes(), type=Job)
    words: list[str] = []
    spoken = threading.Semaphore(0)

    def hear(word: str) -> None:
        words.append(word)
        spoken.release()

    lifeline = Lifeline(True, on_word=hear)
    config = job.settings[agent].config()
    patience_key = "transport/link/tx/queue/congestion_control/drop/wait_before_drop"
    config.insert_json5(patience_key, str(job.variant.patience_us))
    with zenoh.open(config) as session:
        part: Callable[[], Done]
        if agent == ROUTER:
            part = Done
        elif agent == RECORDER:
            part = Tap(job, session, job_file.with_name("bare.mcap"), words).record
        else:
            player = Player(job, agent, session)
            part = player.lead if agent == PLANT else player.follow
        _await_others(session, job, agent, lifeline)
        cpu_began_s = time.process_time()
        spare_the_collector()
        if agent in {PLANT, ROUTER}:
            spoken.acquire()  # The plant is told to begin, the router to end.
        try:
            done = part()
            lifeline.tell(msgspec.structs.replace(done, cpu_s=time.process_time() - cpu_began_s))
        except BareFailure as failure:
            lifeline.tell(Failed(str(failure)))
    return 0


def _await_others(session: zenoh.Session, job: Job, agent: str, lifeline: Lifeline) -> None:
    """Wait for the liveliness tokens of all that this agent talks with.

    On a link declarations travel in order, and an agent's token is its last one: who sees the
    token knows the subscriptions.
    """
    keys = job.graph.plan.keys
    awaited = {keys.alive_key(other): other for other in job.sees.get(agent, ())}
    complain_at = time.monotonic() + 0.75 * ARM_S
    while awaited:
        for reply in session.liveliness().get(f"{keys.plant}/**/alive", timeout=1.0):
            if reply.ok is not None:
                awaited.pop(str(reply.ok.key_expr), None)
        if awaited and time.monotonic() > complain_at:
            lifeline.tell(Absent(sorted(awaited.values())))
            complain_at += ARM_S
        time.sleep(0.05 if awaited else 0.0)
    lifeline.tell(Joined())


# The run as a whole -----------------------------------------------------------------------------


class BareResult(msgspec.Struct, frozen=True):
    """One run of the graph.

    Attributes
    ----------
    startup_s
        From the start of the first process to the first cycle that counts.
    sent, recorded
        Messages of all agents, and those that the recorder wrote; None without a recorder.
    unfinished
        In real time: cycles that the plant did not see the end of.
    cpu_ms
        Processor time of all processes in a cycle.
    """

    variant: str
    cycles: int
    cycles_per_s: float
    startup_s: float
    sent: int
    recorded: int | None
    unfinished: int
    cpu_ms: float

    @property
    def lost(self) -> int:
        """Messages that did not arrive at the recorder."""
        return 0 if self.recorded is None else self.sent - self.recorded


@dataclass
class Process:
    """One started process and what it has said."""

    agent: str
    handle: subprocess.Popen[bytes]
    log: Path
    said: list[AnyEvent] = field(default_factory=list)
    closed: bool = False
    _pending: bytes = b""

    def feed(self, chunk: bytes) -> None:
        *lines, self._pending = (self._pending + chunk).split(b"\n")
        for line in lines:
            with suppress(msgspec.DecodeError):
                self.said.append(msgspec.json.decode(line, type=AnyEvent))

    def heard(self, kind: Callable[[AnyEvent], bool]) -> bool:
        return any(kind(event) for event in self.said)

    def account(self) -> Done:
        return next(event for event in self.said if isinstance(event, Done))

    def tell(self, word: str) -> None:
        if self.handle.stdin is not None:
            with suppress(BrokenPipeError):
                self.handle.stdin.write(f"{word}\n".encode())
                self.handle.stdin.flush()


class Processes:
    """The processes of a bare run. Leaving the context ends those that are left, by handle."""

    def __init__(self, job: Job, job_file: Path) -> None:
        self._job = job
        self._job_file = job_file
        self._selector = selectors.DefaultSelector()
        self.all: dict[str, Process] = {}

    def __enter__(self) -> Processes:
        try:
            for agent in self._job.settings:
                self._start(agent)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        for process in self.all.values():
            if process.handle.poll() is None:
                process.handle.kill()
            process.handle.wait()
            for pipe in (process.handle.stdin, process.handle.stdout):
                if pipe is not None:
                    with suppress(BrokenPipeError):
                        pipe.close()
        self._selector.close()

    def players(self) -> Iterator[Process]:
        """All but recorder and router."""
        return (p for p in self.all.values() if p.agent not in {RECORDER, ROUTER})

    def await_all(
        self, awaited: list[Process], kind: Callable[[AnyEvent], bool], timeout_s: float
    ) -> list[Process]:
        """Listen until each has said something of a kind. Return those that have not in time.

        Raises
        ------
        BareFailure
            One gave up or ended.
        """
        until = time.monotonic() + timeout_s
        while late := [process for process in awaited if not process.heard(kind)]:
            if time.monotonic() > until:
                return late
            self._listen(0.2)
            self._check()
        return []

    def _listen(self, timeout_s: float) -> None:
        for key, _ in self._selector.select(timeout_s):
            process: Process = key.data
            chunk = os.read(key.fd, 1 << 16)
            if chunk:
                process.feed(chunk)
            else:
                self._selector.unregister(key.fileobj)
                process.closed = True

    def _check(self) -> None:
        if any(process.heard(_is_failure) for process in self.all.values()):
            # The others that wait say so at about the same time.
            until = time.monotonic() + 1.0
            while time.monotonic() < until:
                self._listen(0.2)
            silent = [p.agent for p in self.players() if not p.heard(_is_account)]
            culprits = f"nothing came from {', '.join(silent)}; " if silent else ""
            raise BareFailure(f"stalled: {culprits}" + "; ".join(self._failures()[:5]))
        for process in self.all.values():
            if process.closed and not process.heard(_is_account):
                last = process.log.read_text(errors="replace").splitlines()[-3:]
                raise BareFailure(f"{process.agent} ended before its time: {' | '.join(last)}")

    def _failures(self) -> list[str]:
        return [
            f"{process.agent} {event.text}"
            for process in self.all.values()
            for event in process.said
            if isinstance(event, Failed)
        ]

    def _start(self, agent: str) -> None:
        env = environment()
        if agent == ROUTER or not self._job.variant.one_thread:
            del env["ZENOH_RUNTIME"]
        log = self._job_file.with_name(f"{agent.replace('/', '.')}.log")
        with log.open("wb") as log_file:
            handle = subprocess.Popen(
                (sys.executable, __file__, "--play", agent, "--job", str(self._job_file)),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log_file,
                env=env,
                process_group=0,
            )
        process = Process(agent, handle, log)
        self.all[agent] = process
        assert handle.stdout is not None
        self._selector.register(handle.stdout, selectors.EVENT_READ, process)


def _is_failure(event: AnyEvent) -> bool:
    return isinstance(event, Failed)


def _is_ready(event: AnyEvent) -> bool:
    return isinstance(event, Joined)


def _is_account(event: AnyEvent) -> bool:
    return isinstance(event, Done | Failed)


def run_bare(graph: Graph, variant: Variant, cycles: int) -> BareResult:
    """Run the graph once.

    Raises
    ------
    BareFailure
        It did not arm or did not go on; the text says who is missing.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bare-")))
        job = stack.enter_context(_planned(graph, variant, cycles))
        job_file = folder / "job.json"
        job_file.write_bytes(msgspec.json.encode(job))
        started = time.monotonic()
        processes = stack.enter_context(Processes(job, job_file))
        return _conduct(processes, job, started)


def _conduct(processes: Processes, job: Job, started: float) -> BareResult:
    everybody = list(processes.all.values())
    late = processes.await_all(everybody, _is_ready, ARM_S)
    if late:
        reasons = "; ".join(filter(None, [*map(_what_it_misses, late), _says_nothing(late)]))
        raise BareFailure(f"not armed after {ARM_S:g} s: {reasons}")
    processes.all[PLANT].tell("go")
    # Two cycles per second is far below anything that is worth waiting for.
    limit_s = 30.0 + job.cycles / (job.variant.rate_hz or 2.0)
    players = list(processes.players())
    late = processes.await_all(players, _is_account, limit_s)
    if late:
        raise BareFailure(f"no end of {', '.join(p.agent for p in late)} within {limit_s:g} s")
    sent = sum(player.account().sent for player in players)
    others = [process for process in everybody if process not in players]
    for other in others:
        other.tell(str(sent))
    if processes.await_all(others, _is_account, 10 * _QUIET_S):
        raise BareFailure("the recorder did not close its file")
    lead = processes.all[PLANT].account()
    cpu_s = sum(process.account().cpu_s for process in everybody)
    return BareResult(
        variant=job.variant.name,
        cycles=job.cycles,
        cycles_per_s=job.cycles / ((lead.ended_ns - lead.began_ns) / 1e9),
        startup_s=lead.began_ns / 1e9 - started,
        sent=sent,
        recorded=processes.all[RECORDER].account().written if job.variant.recorder else None,
        unfinished=lead.unfinished,
        cpu_ms=1e3 * cpu_s / (job.cycles + (0 if job.variant.rate_hz else _WARM_UP)),
    )


def _what_it_misses(process: Process) -> str:
    unseen = [name for event in process.said if isinstance(event, Absent) for name in event.agents]
    return f"{process.agent} does not see {', '.join(unseen)}" if unseen else ""


def _says_nothing(late: list[Process]) -> str:
    silent = [process.agent for process in late if not process.said]
    load = os.getloadavg()[0]
    return f"{', '.join(silent) or 'nobody'} says nothing at all; load average {load:.1f}"


@contextmanager
def _planned(graph: Graph, variant: Variant, cycles: int) -> Iterator[Job]:
    """Work out who joins the bus where; keep the ports as long as the context lasts."""
    tree = graph.plan.tree
    agents = tuple(agent for agent in tree.agents() if variant.recorder or agent != RECORDER)
    links = Links(tuple(pair for pair in explicit_links(tree).pairs if {*pair} <= {*agents}))
    listening = {"explicit": links.listening, "mesh": agents, "router": (ROUTER,)}
    with reserved_ports(listening[variant.topology]) as tcp_ports:
        endpoint = {agent: f"tcp/127.0.0.1:{port}" for agent, port in tcp_ports.items()}
        settings = {
            agent: _settings(agent, variant, links, tcp_ports, endpoint)
            for agent in ((ROUTER,) if variant.topology == "router" else ()) + agents
        }
        sees = {
            agent: tuple(
                other for other in agents if {(agent, other), (other, agent)} & {*links.pairs}
            )
            for agent in agents
        }
        yield Job(graph, variant, cycles, settings, sees)


def _settings(
    agent: str, variant: Variant, links: Links, tcp_ports: dict[str, int], endpoint: dict[str, str]
) -> SessionSettings:
    run_id = f"bare-{os.getpid()}-{next(iter(tcp_ports.values()))}"
    mode, gossip = "peer", False
    if agent == ROUTER:
        listen, connect, mode = [endpoint[ROUTER]], [], "router"
    elif variant.topology == "router":
        listen, connect, mode = [], [endpoint[ROUTER]], "client"
    elif variant.topology == "mesh":
        hub = next(iter(endpoint))
        listen, connect = [endpoint[agent]], [endpoint[hub]] if agent != hub else []
        gossip = True
    else:
        listen, connect = links.endpoints(agent, tcp_ports)
    return SessionSettings(run_id, listen, connect, mode, gossip, not variant.rate_hz)


def main() -> int:
    """Run the graph once and print what came of it; or be one of its processes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="oahu")
    parser.add_argument("--cycles", type=int, default=800)
    parser.add_argument("--topology", choices=get_args(Topology), default="explicit")
    parser.add_argument("--no-recorder", action="store_true")
    parser.add_argument("--rate", type=float, default=0.0, help="cycles per second; 0: lockstep")
    parser.add_argument("--play", metavar="AGENT", help=argparse.SUPPRESS)
    parser.add_argument("--job", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.play:
        return play(options.job, options.play)
    variant = Variant(
        topology=options.topology, recorder=not options.no_recorder, rate_hz=options.rate
    )
    try:
        graph = graph_of(options.scenario, options.cycles)
        result = run_bare(graph, variant, options.cycles)
    except BareFailure as failure:
        sys.stderr.write(f"bare graph: {failure}\n")
        return 1
    print(f"{graph.messages} messages of {graph.payload_bytes} bytes in a cycle")
    print(f"{result.cycles_per_s:.1f} cycles/s after {result.startup_s:.1f} s to start up")
    print(f"{result.cpu_ms:.1f} ms of processor time in a cycle, all processes together")
    print(f"{result.sent:,} messages sent, {result.lost:,} of them lost")
    return 1 if result.lost and not result.unfinished else 0


if __name__ == "__main__":
    sys.exit(main())
