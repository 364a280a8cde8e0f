"""`heliarch launch`: a plant as a team of processes, from start to summary."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

import msgspec

from agents.cycle import kind_of
from agents.plan import RunPlan
from agents.process.events import (
    Armed,
    Complaint,
    Event,
    Joined,
    Over,
    Recorded,
    RecordingEnded,
    Start,
    Status,
)
from agents.process.interruption import Interruption, interruptible
from agents.process.machine import refusals
from bus_schemas.errors import FailureError, InputError, listed
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import PLANT, RECORDER
from launch_scripts.account import RunAccount
from launch_scripts.hearing import Hearing
from launch_scripts.restarts import Restarts
from launch_scripts.run_folder import RunFolder
from launch_scripts.supervision import (
    Child,
    Children,
    ForkServerProcess,
    has_exited,
    is_through,
    stall,
    still_waiting,
)
from launch_scripts.view import View
from launch_scripts.watch import SILENT_S, Externals, Watch
from results.run_summary import RunSummary
from scenarios.elsewhere import check_devices, listening
from scenarios.preparation import Preparation
from sunspec.process import GatewayProcess, PlantUnitProcess

_ARMING_S: Final = 60.0
"""How long it may take to cycle 0 once no more processes come onto the bus. The plant gives up
before that by itself."""

_END_S: Final = 5.0
"""Once the run is over: how long nothing may come from processes that are to end, and once more
after each step that is to end them."""

_STOP_S: Final = 5.0
"""How long the plant may take to end the run after Ctrl-C, and two cycles more."""

_GATHER_S: Final = 0.5
"""After the first event of a stall, beside the time that each agent waits before it says so: for
the others to say what they wait for. Who lives and waits must not be killed."""

_UNKNOWN: Final = 1 << 62
"""More messages than any run has."""


class _Launch:
    """One run over processes, see `launch`."""

    def __init__(
        self,
        account: RunAccount,
        view: View,
        children: Children,
        gateway: GatewayProcess | None,
        unit: PlantUnitProcess | None,
        interruption: Interruption,
    ) -> None:
        self._account = account
        self._view = view
        self._children = children
        self._gateway = gateway
        self._unit = unit
        self._interruption = interruption
        plan = account.preparation.plan
        self._watch = Watch(plan, children)
        self._restarts = Restarts(plan, children, self._watch, self._start_again, view.say)
        self._hearing = Hearing(plan, children, self._watch, self._restarts, view.say)
        self._externals = Externals(plan, view.say)
        self._stalled_at: float | None = None
        self._stop_asked_at: float | None = None
        self._over: Over | None = None

    @property
    def _plan(self) -> RunPlan:
        return self._account.preparation.plan

    @property
    def _is_armed(self) -> bool:
        return self._account.armed_at > 0.0

    def run(self) -> RunSummary:
        """Start the processes, see them through the run, compare what they say at its end."""
        children, account, plan = self._children, self._account, self._plan
        self._view.say(
            f"starting {len(children.by_agent)} processes, logs in {account.folder.logs}"
        )
        external_s = account.preparation.options.external_timeout_s
        for line in _directions(plan, account.folder.plan, external_s):
            self._view.say(line)
        self._start(tuple(children.by_agent))
        try:
            self._arm(external_s)
            self._follow()
        except FailureError as failure:
            if not self._externals.unheard:
                raise
            # An external agent is the likely cause, and all others wait for it.
            keys = listed(self._externals.unheard)
            text = f"no answer to the arming rounds came on {keys}\n{failure}"
            raise FailureError(text) from failure
        ended_at = time.monotonic()
        self._restarts.end()
        # A process that was away at the end did not hear the stop.
        children.ask_to_end(children[name] for name in self._restarts.counts if name != RECORDER)
        recorded = self._finish()
        for child in children:
            account.add_process(child)
        for process, count in self._restarts.counts.items():
            account.restarts.update(dict.fromkeys(plan.wiring.members_of(process), count))
        for process, cycle in self._restarts.given_up.items():
            account.given_up |= dict.fromkeys(plan.wiring.members_of(process), cycle)
        account.recording_gaps = self._hearing.gaps
        if PLANT in children.by_agent:  # The recorder may not have heard of all cycles.
            cycles = children.table.read(PLANT).cycle
            recorded = msgspec.structs.replace(recorded, cycles=cycles)
        # In real time the last cycle lasts to its end, though all have done their part before.
        cycles_s = recorded.cycles * plan.timing.cycle_wall_ns / 1e9
        return account.summary(
            recorded,
            max(ended_at - account.armed_at, cycles_s),
            interrupted=bool(self._interruption),
            devices=self._gateway.end() if self._gateway is not None else (),
        )

    def _start(self, agents: tuple[str, ...], *, again: bool = False) -> None:
        folder = self._account.folder
        self._children.server.ask(Start(str(folder.plan), agents, str(folder.logs), again))

    def _start_again(self, agent: str) -> None:
        if agent == RECORDER and not self._is_armed:  # Nothing has been recorded yet.
            self._account.folder.recording.unlink(missing_ok=True)
        self._start((agent,), again=self._is_armed)

    def _arm(self, external_s: float) -> None:
        """See the processes onto the bus, and to the beginning of cycle 0."""
        children, externals = self._children, self._externals
        began_at = joined_at = time.monotonic()
        while not self._is_armed:
            if any(isinstance(event, Joined) for _, event in self._look()):
                joined_at = time.monotonic()
            if self._interruption:
                raise KeyboardInterrupt  # There is no cycle yet that could be completed.
            now, complete_at = time.monotonic(), externals.complete_at
            if complete_at is None:
                if now > began_at + external_s:
                    raise FailureError(
                        f"no sign of {', '.join(externals.awaited)} after {external_s:g} s: no "
                        "liveliness token was seen; the lines above and "
                        f"{self._account.folder.plan} say where a device finds the bus"
                    )
            elif now > max(complete_at, joined_at) + _ARMING_S:
                text = f"not armed {_ARMING_S:.0f} s after the last process came: see"
                absent = next((one.agent for one in children if not self._is_present(one)), PLANT)
                raise children.failure(absent, f"{text} {absent}")
        took_s = self._account.armed_at - began_at
        self._view.say(f"armed: cycle 0 began {took_s:.2f} s after the processes were started")

    def _is_present(self, child: Child) -> bool:
        return child.ready and self._watch.silent_s(child) < SILENT_S

    def _follow(self) -> None:
        """Show the run until the plant says that it is over."""
        while not self._is_over():
            self._look()
            self._check_stall()
            if (failure := self._externals.failure()) is not None:
                raise self._children.failure(*failure)
            if self._interruption:
                self._ask_stop()

    def _is_over(self) -> bool:
        """Whether the run is over; for an external plant the recorder says so."""
        children = self._children
        if PLANT in children.by_agent:
            return children[PLANT].finished is not None
        # An external plant cannot be stopped: after Ctrl-C the controllers end by themselves.
        left = [child for child in children.controllers() if child.finished is None]
        return self._over is not None or (self._stop_asked_at is not None and not left)

    def _look(self) -> list[tuple[Child, Event]]:
        """Take in what has happened, and do what is due; return what the processes have said."""
        heard = self._children.events(0.1)
        for child, event in heard:
            self._hear(event)
            self._watch.hear(child, event)
            self._externals.hear(event)
        if self._gateway is not None:
            self._gateway.look(self._view.say)
        if self._unit is not None and (status := self._unit.process.poll()) is not None:
            name = f"the plant's Modbus unit (process {self._unit.process.pid})"
            self._view.say(f"{name} ended with status {status}; the run goes on without it")
            cycle = self._children.table.read(PLANT).cycle
            self._account.given_up["Modbus unit"] = max(cycle, 0)
            self._unit = None
        self._restarts.look()
        return heard

    def _hear(self, event: Event) -> None:
        match event:
            case Armed():
                self._account.armed_at = time.monotonic()
                for child in self._children:
                    child.cpu_at_start_s = child.cpu_s()
                self._restarts.begin(event.start_time_ns / 1e9)
            case Status():
                self._view.show(event)
                if self._is_armed and not self._is_over():
                    self._hearing.hear(event)
            case Over():
                self._over = event
            case Complaint():
                self._view.say(f"wrong message on {event.key}: {event.example}")
            case RecordingEnded():
                self._view.say(f"{event.text}; the run goes on without it")

    def _check_stall(self) -> None:
        """In lockstep: find who stalls the run."""
        children, now = self._children, time.monotonic()
        waiting = still_waiting(children)
        self._stalled_at = (self._stalled_at or now) if waiting else None
        gather_s = _GATHER_S + self._plan.timing.stall_timeout_s
        if self._stalled_at is None or now < self._stalled_at + gather_s:
            return
        line, to_blame = stall(children, self._plan)
        # While the recorder stands still, everybody waits for it.
        recorder = children[RECORDER]
        if recorder.ready and not self._is_present(recorder):
            return
        if not self._restarts.mends(to_blame):
            raise children.failure(to_blame[0], line)
        for child in waiting:
            child.waiting = None

    def _ask_stop(self) -> None:
        """Let the plant end the run; lose patience after a while, or at the second Ctrl-C."""
        children, now = self._children, time.monotonic()
        if self._stop_asked_at is None:
            self._restarts.end()
            self._view.say("interrupted: ending after this cycle")
            has_plant = PLANT in children.by_agent
            children.ask_to_end([children[PLANT]] if has_plant else children.controllers())
            self._stop_asked_at = now
        longest_s = _STOP_S + 2.0 * self._plan.timing.cycle_wall_ns / 1e9
        if self._interruption.count > 1 or now > self._stop_asked_at + longest_s:
            raise KeyboardInterrupt

    def _finish(self) -> Recorded:
        """Wait until all agents have ended; then let the recorder close its file."""
        children, account, recorder = self._children, self._account, self._children[RECORDER]
        is_early = self._over is not None and self._over.cycle < self._plan.timing.cycles
        if self._interruption or is_early:
            # After an early end, a controller waits in case the plant goes on after all.
            children.ask_to_end(children.controllers())
        self._await(children.controllers(), is_through)
        for child in children.controllers():
            if child.finished:
                account.published.update(child.finished.published)
        account.is_complete = not self._restarts.lost_processes
        # It is unknown what a process that died had published: wait until nothing more comes.
        children.end_recorder(account.published.total() if account.is_complete else _UNKNOWN)
        self._await([recorder])
        children.table.close_recording()
        self._await(children.controllers())
        return recorder.recorded or Recorded({}, 0, 0, "the recorder did not close its file")

    def _await(self, some: list[Child], is_done: Callable[[Child], bool] = has_exited) -> None:
        """Wait until processes end. Those that do not are asked to, and at last killed."""
        for step in (self._children.ask_to_end, self._restarts.end_by_force, self._leave):
            if not (left := self._children.await_end(some, _END_S, is_done, self._look)):
                return
            if self._watch.server_stands_still:
                self._leave(left)
                return
            step(left)

    def _leave(self, children: Sequence[Child]) -> None:
        """Leave processes to the end of the fork server, which does not say that they ended."""
        if "fork server" in self._account.given_up:
            return
        server = f"fork server (process {self._children.server.process.pid})"
        self._view.say(f"the {server} did not end {len(children)} processes: it is killed")
        self._account.given_up["fork server"] = max(self._children.table.read(PLANT).cycle, 0)


def _directions(plan: RunPlan, plan_path: Path, timeout_s: float) -> Iterator[str]:
    """Say what is waited for, and how agents that the launcher does not start can join the run."""
    if not plan.elsewhere:
        return
    yield f"waiting up to {timeout_s:g} s for {', '.join(plan.elsewhere)}, plan: {plan_path}"
    for agent in plan.access.external:
        yield f"  {agent}: {_links(plan, agent)}"
    for host in dict.fromkeys(plan.access.addresses.values()):
        command = f"heliarch node --plan plan.json --host {host}"
        yield f"  on {host}, with a copy of the plan: {command}"


def _links(plan: RunPlan, agent: str) -> str:
    listeners = {
        f"{plan.access.host_of(name)}:{port}": name for name, port in plan.access.tcp_ports.items()
    }
    listens, connects = plan.links.endpoints(agent, plan.access.tcp_ports, plan.access.host_of)
    targets = ", ".join(f"{end} ({listeners[end]})" for end in connects)
    parts = [f"listens on {', '.join(listens)}"] if listens else []
    parts += [f"connects to {targets}"] if targets else []
    token = plan.wiring.alive_key(agent)
    return f"{', '.join(parts)}, namespace {plan.bus_namespace}, liveliness token {token}"


def check_processes(plan: RunPlan) -> None:
    """Refuse what a run as processes cannot have."""
    if plan.timing.lockstep and plan.faults.rules:
        raise InputError.of(
            "--pace",
            "expected a number such as 1, since faults need real time, got lockstep, where an "
            "agent would wait forever for a lost message",
        )
    kinds = {kind_of(agent, plan.tree) for agent in plan.processes}
    for kind in plan.supervision.machine.cpus_of.keys() - kinds:
        expected = "a kind that has processes of its own (see `processes` in the scenario)"
        raise InputError.of(f"--cpus {kind}", f"expected {expected}")
    check_devices(plan)
    if plan.access.keys_folder:
        from scenarios.plant_keys import check_keys  # noqa: PLC0415 - optional

        check_keys(plan)


def launch(
    preparation: Preparation,
    folder: RunFolder,
    view: View,
    began_at: float,
    server: ForkServerProcess,
) -> RunSummary:
    """Run and record a plant as processes over Zenoh, which the server starts.

    The user asked for it at `began_at`, monotonic [s].
    """
    base_port, plan = preparation.options.base_port, preparation.plan
    agents, further = listening(plan)
    further_port = None if base_port is None else base_port + len(agents)
    refused = refusals(plan.supervision.machine, lockstep=plan.timing.lockstep)
    for line in refused:
        view.say(line)
    with (
        GatewayProcess(plan) if plan.site.devices else nullcontext() as gateway,
        reserved_ports(agents, base_port, plan.access.address, plan.access.external) as tcp_ports,
        reserved_ports(further, further_port, plan.access.address) as agent_ports,
        interruptible() as interruption,
    ):
        plan = folder.fill(preparation, tcp_ports, agent_ports)
        remarks = (*preparation.remarks, *refused)
        account = RunAccount(
            replace(preparation, plan=plan, remarks=remarks), folder, "launch", began_at
        )
        if gateway is not None:
            gateway.join(folder.path)
        own = tuple(agent for agent in plan.processes if agent not in plan.elsewhere)
        address = preparation.options.operator
        try:
            with (
                Children(server, plan, own, folder.logs) as children,
                PlantUnitProcess(address, folder.path) if address else nullcontext() as unit,
            ):
                return _Launch(account, view, children, gateway, unit, interruption).run()
        except FailureError as failure:
            with suppress(OSError):  # The disk may be full: that must not hide the failure.
                folder.failure.write_text(f"{failure}\n", encoding="utf-8")
            raise
