"""Replay with live controllers: the named ones as processes, and their messages compared.

The other agents do what they did, whatever the live ones publish: the loop is open. In lockstep a
cycle begins when the live controllers have finished the earlier ones. In real time every message
goes out at its recorded time, and the live controllers have their deadlines.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import count
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, TextIO

import msgspec
import zenoh
from msgspec.structs import replace

from agents.cycle import stage_of
from agents.plan import RunPlan, changed, load_plan
from agents.process.events import Start
from agents.process.interruption import Interruption, interruptible
from agents.process.machine import MachineSettings
from bus_schemas.codec import decode, encode
from bus_schemas.errors import FailureError, InputError, listed
from bus_schemas.inbox import Inbox
from bus_schemas.messages import Message, Run
from bus_schemas.selection import find_nodes
from bus_schemas.signals import RUN, Port
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import REPLAYER, ROOT, ControlTree, agent_name
from launch_scripts.supervision import Children, ForkServerProcess, stall
from recordings.read.gaps import due_step
from recordings.read.reader import RunReader
from recordings.read.run_clock import RunClock
from recordings.replay.bus import ReplayBus, await_subscriber, replay_bus, say, selected_ports
from recordings.replay.keyboard import no_keyboard
from recordings.replay.playback import Playback, StatusLine
from recordings.replay.schedule import PlaybackClock
from recordings.verify.comparison import AgentResult, Equality
from recordings.verify.report import agents_data, difference_lines
from sim_plant.plant_run import FIRST_ROUND, longest_round_s

_OTHERS: Final = "others"
_SHARED: Final = (
    *("plant", "inverters", "timing.start_time_ns"),
    *("timing.cycle_ns", "timing.cycle_wall_ns", "control.period_cycles"),
)
"""Fields in which the plan of the live controllers must be that of the recorded run."""

_ARMING_S: Final = 30.0
_EARLY_CYCLES: Final = 100
"""Every agent publishes within so many first cycles, even if messages are lost."""
_LOOK_S: Final = 0.1
"""How often the processes are checked."""
_END_S: Final = 5.0
"""How long the live controllers may take to end after the run."""


_EQUAL: Final = Equality(ignored=frozenset({"incarnation"}))
"""A live controller is not started again, and no standby takes it over."""


def replay_live(
    reader: RunReader,
    out: TextIO,
    line: StatusLine,
    live_nodes: str,
    *,
    plan_file: Path | None,
    end: str | None,
    wait: bool,
    listen: str | None,
) -> dict[str, Any]:
    """Replay with live controllers, and print in what they differ; return the figures for JSON.

    The arguments are the options of `heliarch replay`.
    """
    live = tuple(map(agent_name, find_nodes(reader.plan.tree, live_nodes, "--live")))
    plan = _plan(reader, plan_file, end)
    began_at = time.monotonic()
    with (
        interruptible() as interruption,
        _folder() as folder,
        ForkServerProcess() as server,
        reserved_ports((_OTHERS, *live)) as tcp_ports,
        Children(server, plan, live, folder) as children,
    ):
        path = folder / "plan.json"
        its_plan = _live_plan(plan, tcp_ports)
        path.write_bytes(its_plan.as_json())
        with (
            replay_bus(reader, selected_ports(reader), listen, out) as observers,
            LiveBus(its_plan, tcp_ports[_OTHERS], observers, children, interruption) as bus,
        ):
            say(out, f"live: {', '.join(live)}; all others as recorded")
            server.ask(Start(str(path), tuple(live), str(folder)))
            clock = PlaybackClock(0.0 if plan.timing.lockstep else 1.0, sleep=bus.listen)
            span = range(plan.timing.cycles)
            playback = Playback(
                reader, reader.ports(), span, bus, clock, no_keyboard, interruption, line
            )
            bus.arm(reader)
            if wait:
                await_subscriber(observers, interruption, out)
            playback.play()
            bus.finish()
    wall_s = time.monotonic() - began_at
    results = bus.pairs.results
    compared = sum(result.compared for result in results.values())
    differing = {name: one.differences.total() for name, one in results.items() if one.first}
    say(out, f"compared {compared:,} messages over {bus.cycles:,} cycles in {wall_s:.1f} s")
    of_run = RunClock(plan, bus.cycles - 1)
    for text in difference_lines(results, of_run):
        say(out, text)
    replaced = {agent: sorted(cycles) for agent, cycles in bus.pairs.replaced.items()}
    for agent, cycles in replaced.items():
        when = listed([of_run.span_text(cycle, cycle) for cycle in cycles], 3)
        say(out, f"{agent}: in the run a new process replaced it {when}; the live one went on")
    say(out, f"differences: {sum(differing.values()):,}")
    return {
        "run_id": plan.run_id,
        "recording": str(reader.path),
        "live": live,
        "cycles": bus.cycles,
        "wall_s": wall_s,
        "compared": compared,
        "differing": differing,
        "replaced": replaced,
        "agents": agents_data(results),
        "interrupted": bool(interruption),
    }


@contextmanager
def _folder() -> Iterator[Path]:
    """Make a folder for plan and logs. If the replay fails, it is kept and named."""
    folder = Path(tempfile.mkdtemp(prefix="heliarch-replay-"))
    try:
        yield folder
    except FailureError as failure:
        raise FailureError(f"{failure}\nlogs of the live controllers: {folder}") from None
    except BaseException:
        shutil.rmtree(folder)
        raise
    shutil.rmtree(folder)


def _live_plan(plan: RunPlan, tcp_ports: dict[str, int]) -> RunPlan:
    """Return the plan by which live controllers find each other, and all others at one TCP port."""
    ports = {agent: tcp_ports.get(agent, tcp_ports[_OTHERS]) for agent in plan.links.listening}
    access = {"tcp_ports": ports, "namespace": "", "external": (), "address": "127.0.0.1"}
    return changed(
        plan.public,
        access=access | {"addresses": {}},
        faults={"rules": (), "device": ()},
        supervision={"machine": MachineSettings()},
    )


def _plan(reader: RunReader, file: Path | None, end: str | None) -> RunPlan:
    """Return the plan of the live controllers, with the cycles to replay."""
    complete = reader.last_cycle + 1
    if reader.stop_cycle is None:  # The run or the recording broke off.
        complete = max(reader.last_cycle - reader.plan.control.periods.longest, 0)
    if not complete:
        raise InputError(f"{reader.path}: expected a complete cycle, got none")
    plan = reader.plan
    if file is not None:
        plan = load_plan(file)
        for field in _SHARED:
            value_of = attrgetter(field)
            if value_of(plan) != value_of(reader.plan):
                raise InputError(f"{file} {field}: expected that of the recorded run")
    cycles = min(reader.clock.span(None, end).stop, complete)
    # Live controllers are named one by one, and each has a process of its own.
    plan = changed(plan, timing={"cycles": cycles}, supervision={"groups": ()})
    return replace(plan, run_id=reader.plan.run_id)


# The bus ------------------------------------------------------------------------------------------


class MessagePairs:
    """The recorded and the new messages of some agents, and the result of each agent.

    replaced: In which cycles another process of an agent joined the recorded run.
    """

    def __init__(self, tree: ControlTree, agents: Iterable[str]) -> None:
        self.results = {agent: AgentResult() for agent in agents}
        self.replaced = defaultdict[str, set[int]](set)
        self._tree = tree
        # The first is the recorded message, the second the new one.
        self._waiting: dict[tuple[Port[Message], int], list[Message | None]] = {}

    def take(self, port: Port[Message], message: Message, *, is_recorded: bool) -> None:
        """Compare a message with its counterpart, now or when that comes."""
        if is_recorded:
            self.results[port.publisher].recorded += 1
            if message.incarnation:
                self.replaced[port.publisher].add(message.incarnation)
        pair = self._waiting.setdefault((port, message.cycle), [None, None])
        pair[not is_recorded] = message
        if None not in pair:
            self._compare(port, message.cycle)

    def finish(self, before_cycle: int) -> None:
        """Count the messages without a counterpart in the cycles before one."""
        for port, cycle in list(self._waiting):
            if cycle < before_cycle:
                self._compare(port, cycle)

    def _compare(self, port: Port[Message], cycle: int) -> None:
        recorded, new = self._waiting.pop((port, cycle))
        stage = stage_of(port, self._tree)
        self.results[port.publisher].compare(_EQUAL, port, recorded, new, stage)


class LiveBus(ReplayBus):
    """Gives live controllers the messages of the others, observers those of all, and compares.

    The plan is that of the live controllers; its cycles are those to run.

    cycles: How many are over.
    """

    def __init__(
        self,
        plan: RunPlan,
        tcp_port: int,
        observers: ReplayBus,
        children: Children,
        interruption: Interruption,
    ) -> None:
        live, ports = children.by_agent.keys(), plan.wiring.ports
        unsent = {*live, REPLAYER}
        others = [port for port in ports if port.publisher not in unsent]
        super().__init__(plan, others, f"tcp/127.0.0.1:{tcp_port}")
        self.pairs = MessagePairs(plan.tree, live)
        self.cycles = 0
        self._observers = observers
        self._children = children
        self._interruption = interruption
        self._inbox = Inbox()
        self._newest = dict.fromkeys((one for one in ports if one.publisher in live), FIRST_ROUND)
        self._received = 0
        self._subscribers = [
            self.session.declare_subscriber(
                plan.wiring.key(port),
                zenoh.handlers.Callback(self._inbox.callback(port), indirect=False),
                allowed_origin=zenoh.Locality.REMOTE,
            )
            for port in self._newest
        ]

    def arm(self, reader: RunReader) -> None:
        """Send arming rounds until the live controllers are there and answer a whole one.

        In a round the other agents publish what they published first in the run.
        """
        first = self._first_messages(reader)
        give_up_at = time.monotonic() + _ARMING_S
        for number in count(1):
            cycle = FIRST_ROUND + number
            sim_time_ns = self._plan.timing.sim_time_ns(cycle)
            for port, message in first.items():
                stamped = replace(message, cycle=cycle, sim_time_ns=sim_time_ns, missing=())
                super().put(port, encode(stamped))
            silent = self._await_cycle(cycle, longest_round_s(number))
            if not silent:
                return
            if self._interruption:
                raise KeyboardInterrupt
            if time.monotonic() > give_up_at:
                names = listed(sorted(map(str, silent)))
                raise FailureError(f"no arming round closed: nothing came on {names}")

    def put(self, port: Port[Message], payload: bytes) -> bool:
        """Take in a recorded message; return whether it was sent as it is."""
        if port.signal is RUN:
            run = decode(RUN, payload)
            if run.state == "start":
                lead_ns = run.start_time_ns - run.publish_time_ns
                self._publish_run(replace(run, start_time_ns=time.monotonic_ns() + lead_ns))
            return False
        if port in self._newest:
            self.pairs.take(port, decode(port.signal, payload), is_recorded=True)
            return False
        self._observers.put(port, payload)
        return super().put(port, payload)

    def announce(self, cycle: int, *, rate: float, paused: bool) -> None:
        """Begin a cycle; in lockstep, wait until no live controller is too far behind."""
        # One agent may be some cycles ahead of another.
        self._complete(cycle - self._plan.control.periods.longest)
        self._observers.announce(cycle, rate=rate, paused=paused)

    def listen(self, seconds: float) -> None:
        """Take in what the live controllers publish, until something has come or a time is over."""
        self._receive(1, seconds)

    def finish(self) -> None:
        """End the run, unless the user did, and compare what is left."""
        self._complete(self._plan.timing.cycles)
        if not self._interruption:
            self._publish_run(self._plan.run_message("stop", self.cycles, 0))
            self._receive_the_last()
        self.pairs.finish(self.cycles)

    def _first_messages(self, reader: RunReader) -> dict[Port[Message], Message]:
        ports = (port for port in self._plan.wiring.ports if port not in self._newest)
        wanted = {port for port in ports if due_step(self._plan, port)}
        first: dict[Port[Message], Message] = {}
        for port, message in reader.on(wanted, range(_EARLY_CYCLES)):
            first.setdefault(port, message)
            if len(first) == len(wanted):
                break
        return first

    def _publish_run(self, run: Run) -> None:
        port = RUN.of(ROOT)
        self._outbox.stamp(port, run, time.monotonic_ns())
        for put in (super().put, self._observers.put):
            put(port, encode(run))

    def _complete(self, cycles: int) -> None:
        """Go on to some number of cycles: in lockstep, wait until they are over."""
        # The live controllers themselves report what they wait for.
        patience_s = self._plan.timing.stall_timeout_s + 1.0
        while self.cycles < cycles and not self._interruption:
            is_silent = self._plan.timing.lockstep and self._await_cycle(self.cycles, patience_s)
            if is_silent and self._interruption:
                return
            if is_silent:
                is_known = any(child.waiting for child in self._children)
                text = f"stalled in cycle {self.cycles}"
                raise FailureError(stall(self._children, self._plan)[0] if is_known else text)
            self.cycles += 1

    def _await_cycle(self, cycle: int, patience_s: float) -> set[Port[Message]]:
        """Return the ports of a cycle, or a round, on which nothing came for a time of silence."""
        awaited = {
            port
            for port in self._newest
            if (step := due_step(self._plan, port)) and (cycle < 0 or cycle % step == 0)
        }
        until = time.monotonic() + patience_s
        while awaited := {port for port in awaited if self._newest[port] < cycle}:
            if self._receive(len(awaited), _LOOK_S):
                until = time.monotonic() + patience_s
            if self._interruption or time.monotonic() > until:
                break
        return awaited

    def _receive(self, wanted: int, timeout_s: float) -> int:
        """Take in what the live controllers publish within a time; return how many messages."""
        arrivals = self._inbox.take(wanted, timeout_s)
        for port, received, _ in arrivals:
            payload = received.to_bytes()
            try:
                message = decode(port.signal, payload)
            except msgspec.DecodeError as error:
                expected = port.signal.type.__name__
                raise FailureError(f"{port}: expected a {expected}, got: {error}") from None
            self._newest[port] = message.cycle
            if message.cycle >= 0:
                self._received += 1
                self._observers.put(port, payload)
                self.pairs.take(port, message, is_recorded=False)
        self._children.events(0.0)
        return len(arrivals)

    def _receive_the_last(self) -> None:
        """Let the controllers end, and receive all that they have sent."""
        self._children.table.close_recording()
        if late := self._children.await_end(list(self._children), _END_S):
            agent = late[0].agent
            raise self._children.failure(agent, f"{agent} did not end with the run")
        ended = [child.finished for child in self._children if child.finished is not None]
        sent = sum(sum(finished.published.values()) for finished in ended)
        until = time.monotonic() + _END_S
        while self._received < sent and time.monotonic() < until:
            self._receive(sent - self._received, _LOOK_S)
