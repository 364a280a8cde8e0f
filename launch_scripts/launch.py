"""`heliarch launch`: a plant as a team of processes, from start to summary."""

from __future__ import annotations

import dataclasses
import os
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from msgspec.structs import replace

from agents.cycle import kind_of
from agents.plan import RunPlan
from agents.process.events import (
    Armed,
    Complaint,
    Event,
    Over,
    Recorded,
    Remark,
    Status,
)
from agents.process.interruption import Interruption, interruptible
from agents.process.machine import refusals, take_files
from bus_schemas.errors import FailureError, InputError, listed
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import PLANT, RECORDER
from launch_scripts.fork_server_process import ForkServer
from launch_scripts.process_record import Process, has_exited, is_through
from launch_scripts.processes import Processes
from launch_scripts.run_end import Dropped, begun, ended, process_account
from launch_scripts.run_folder import RunFolder
from launch_scripts.stall import who_waits
from launch_scripts.view import View
from results.run_document import RunDocument
from scenarios.elsewhere import check_devices, listening
from scenarios.preparation import Preparation
from sim_plant.order_desk import SOCKET_NAME
from sunspec.process import GatewayProcess, PlantUnitProcess

_END_S: Final = 5.0
"""After a run: how long processes may take to end, and again after each step to end them."""

_STOP_S: Final = 5.0
"""How long the plant may take to end the run after Ctrl-C, beside two cycles."""

_GATHER_S: Final = 0.5
"""After the first event of a stall: for others to say what they wait for, so that none that merely
waits is killed."""

_LONGEST_PARENT: Final = 70
"""Of the folder of sockets: a socket's path has 107 characters at most."""

_UNKNOWN: Final = 1 << 62
"""More messages than any run has."""


@dataclass
class _Launch:
    """One run over processes, see `run_as_processes`; the user asked for it at `began_at`."""

    preparation: Preparation
    folder: RunFolder
    began_at: float
    view: View
    processes: Processes
    gateway: GatewayProcess | None
    unit: PlantUnitProcess | None
    interruption: Interruption
    armed_at: float = 0.0
    published: Counter[str] = field(default_factory=Counter)
    given_up: dict[str, int] = field(default_factory=dict)
    unheard: Sequence[str] = ()
    recorded: int = -1
    is_cut_off: bool = False
    stalled_at: float | None = None
    stop_asked_at: float | None = None
    over: Over | None = None

    @property
    def _plan(self) -> RunPlan:
        return self.preparation.plan

    def run(self) -> RunDocument:
        processes, plan, folder = self.processes, self._plan, self.folder
        self.view.say(f"starting {len(processes.own)} processes, logs in {folder.logs}")
        external_s = self.preparation.options.external_timeout_s
        for line in _directions(plan, folder.plan, external_s):
            self.view.say(line)
        processes.start()
        try:
            self._arm(external_s)
            self._follow()
        except FailureError as failure:
            if not self.unheard:
                raise
            # An external agent is the likely cause, and all others wait for it.
            text = f"no answer to the arming rounds came on {listed(self.unheard)}\n{failure}"
            raise FailureError(text) from failure
        ended_at = time.monotonic()
        processes.end()
        # A process that was away at the end did not hear the stop.
        restarts = processes.restarts()
        processes.ask_to_end(processes[name] for name in restarts if name != RECORDER)
        recorded = self._finish()
        dropped: Dropped = []
        for process in processes.own:
            dropped += process.finished.dropped if process.finished else ()
        members = plan.wiring.members
        if PLANT in processes:  # The recorder may not have heard of all cycles.
            cycles = processes.table.read(PLANT).cycle
            recorded = replace(recorded, cycles=cycles)
        # In real time the last cycle lasts to its end, though all have done their part before.
        cycles_s = recorded.cycles * plan.timing.cycle_wall_ns / 1e9
        for name, cycle in processes.given_up.items():
            self.given_up |= dict.fromkeys(members[name], cycle)
        document = replace(
            begun(self.preparation, folder, "launch"),
            wall_s=max(ended_at - self.armed_at, cycles_s),
            startup_s=self.armed_at - self.began_at,
            interrupted=bool(self.interruption),
            restarts={one: count for name, count in restarts.items() for one in members[name]},
            given_up=self.given_up,
            processes=tuple(map(process_account, processes.own)),
            devices=self.gateway.end() if self.gateway is not None else (),
        )
        return ended(
            document,
            self.preparation,
            recorded,
            self.published,
            dropped,
            is_complete=not processes.lost_any,
        )

    def _arm(self, external_s: float) -> None:
        processes = self.processes
        began_at = time.monotonic()
        while not processes.has_begun:
            self._look()
            if self.interruption:
                raise KeyboardInterrupt  # There is no cycle yet that could be completed.
            if processes.awaited:
                if time.monotonic() > began_at + external_s:
                    raise FailureError(
                        f"no sign of {', '.join(processes.awaited)} after {external_s:g} s: no "
                        "liveliness token was seen; the lines above and "
                        f"{self.folder.plan} say where a device finds the bus"
                    )
            elif (failure := processes.stuck_start()) is not None:
                raise failure
        took_s = self.armed_at - began_at
        self.view.say(f"armed: cycle 0 began {took_s:.2f} s after the processes were started")

    def _follow(self) -> None:
        while not self._is_over():
            self._look()
            self._check_stall()
            if (failure := self.processes.lost_external()) is not None:
                raise failure
            if self.interruption:
                self._ask_stop()

    def _is_over(self) -> bool:
        """Whether the run is over; for an external plant the recorder says so."""
        processes = self.processes
        if PLANT in processes:
            return processes[PLANT].finished is not None
        # An external plant cannot be stopped: after Ctrl-C the controllers end by themselves.
        left = [process for process in processes.controllers() if process.finished is None]
        return self.over is not None or (self.stop_asked_at is not None and not left)

    def _look(self) -> list[tuple[Process, Event]]:
        heard = self.processes.look()
        for process, event in heard:
            self._hear(process, event)
        if self.gateway is not None:
            self.gateway.look(self.view.say)
        if self.unit is not None and (status := self.unit.process.poll()) is not None:
            name = f"the plant's Modbus unit (process {self.unit.process.pid})"
            self.view.say(f"{name} ended with status {status}; the run goes on without it")
            self.given_up["Modbus unit"] = self.processes.newest_cycle
            self.unit = None
        return heard

    def _hear(self, process: Process, event: Event) -> None:
        match event:
            case Armed():
                self.armed_at = time.monotonic()
            case Status():
                self.unheard = event.unheard
                self.view.show(event)
                if self.processes.has_begun and PLANT in self.processes and not self._is_over():
                    self._note_gap(event)
            case Over():
                self.over = event
            case Remark():
                self.view.say(event.text)
            case Complaint():
                self.view.say(f"wrong message on {event.key}: {event.example}")

    def _note_gap(self, status: Status) -> None:
        """Say when the recorder loses the plant, which goes on, and when it hears it again."""
        self.recorded = cycle = max(self.recorded, status.cycle)
        plant = self.processes[PLANT]
        is_cut_off = PLANT in status.not_recorded and plant.is_there
        if is_cut_off == self.is_cut_off or (is_cut_off and plant.beat.cycle <= cycle + 1):
            return
        self.is_cut_off = is_cut_off
        if not is_cut_off:
            self.view.say(f"recorder hears the plant again, in cycle {cycle:,}")
            return
        others = {process.name for process in self.processes.controllers()}
        lost = set(map(self._plan.wiring.process_of, status.not_recorded))
        whom = "any agent" if others <= lost else "the plant"
        text = f"since cycle {cycle + 1:,} it does not hear {whom}; the run goes on"
        self.view.say(f"recorder is cut off: {text}")

    def _check_stall(self) -> None:
        processes, now = self.processes, time.monotonic()
        waiting = processes.still_waiting()
        self.stalled_at = (self.stalled_at or now) if waiting else None
        gather_s = _GATHER_S + self._plan.timing.stall_timeout_s
        if self.stalled_at is None or now < self.stalled_at + gather_s:
            return
        stopped = [process.name for process in processes.own if process.is_stopped()]
        events = {one.name: one.waiting for one in waiting if one.waiting is not None}
        line, to_blame = who_waits(events, self._plan, stopped)
        # While the recorder stands still, everybody waits for it.
        recorder = processes[RECORDER]
        if recorder.is_there and not processes.is_present(recorder):
            return
        if not processes.mends(to_blame):
            raise processes.failure(to_blame[0], line)
        for process in waiting:
            process.waiting = None

    def _ask_stop(self) -> None:
        """Let the plant end the run; lose patience after a while, or at the second Ctrl-C."""
        processes, now = self.processes, time.monotonic()
        if self.stop_asked_at is None:
            processes.end()
            self.view.say("interrupted: ending after this cycle")
            has_plant = PLANT in processes
            processes.ask_to_end([processes[PLANT]] if has_plant else processes.controllers())
            self.stop_asked_at = now
        longest_s = _STOP_S + 2.0 * self._plan.timing.cycle_wall_ns / 1e9
        if self.interruption.count > 1 or now > self.stop_asked_at + longest_s:
            raise KeyboardInterrupt

    def _finish(self) -> Recorded:
        """Wait until all agents have ended; then let the recorder close its file."""
        processes, recorder = self.processes, self.processes[RECORDER]
        is_early = self.over is not None and self.over.cycle < self._plan.timing.cycles
        if self.interruption or is_early:
            # After an early end, a controller waits in case the plant goes on after all.
            processes.ask_to_end(processes.controllers())
        self._await(processes.controllers(), is_through)
        for process in processes.controllers():
            if process.finished:
                self.published.update(process.finished.published)
        # It is unknown what a process that died had published: wait until nothing more comes.
        processes.end_recorder(_UNKNOWN if processes.lost_any else self.published.total())
        self._await([recorder])
        processes.table.close_recording()
        self._await(processes.controllers())
        return recorder.recorded or Recorded({}, 0, 0, "the recorder did not close its file")

    def _await(self, some: list[Process], is_done: Callable[[Process], bool] = has_exited) -> None:
        """Wait until processes end. Those that do not are asked to, and at last killed."""
        processes = self.processes
        for step in (processes.ask_to_end, processes.end_by_force, self._leave):
            if not (left := processes.await_end(some, _END_S, is_done, self._look)):
                return
            if processes.server_stands_still:
                self._leave(left)
                return
            step(left)

    def _leave(self, some: Sequence[Process]) -> None:
        """Leave processes to the fork server's end, which does not say that they ended."""
        if "fork server" in self.given_up:
            return
        server = self.processes.server.name
        self.view.say(f"the {server} did not end {len(some)} processes: it is killed")
        self.given_up["fork server"] = self.processes.newest_cycle


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
    listeners = {plan.access.endpoint(name): name for name in plan.access.tcp_ports}
    listens, connects = plan.links.endpoints(agent, plan.access.endpoint)
    targets = ", ".join(f"{end} ({listeners[end]})" for end in connects)
    parts = [f"listens on {', '.join(listens)}"] if listens else []
    parts += [f"connects to {targets}"] if targets else []
    token = plan.wiring.alive_key(agent)
    return f"{', '.join(parts)}, namespace {plan.bus_namespace}, liveliness token {token}"


def check_processes(plan: RunPlan) -> None:
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


@contextmanager
def private_folder() -> Iterator[str]:
    """Make a folder of sockets, with a short path, that only the user can enter."""
    parent = os.environ.get("XDG_RUNTIME_DIR", "")
    if not os.access(parent, os.W_OK) or len(parent) > _LONGEST_PARENT:
        parent = "/tmp"
    folder = tempfile.mkdtemp(prefix="heliarch-", dir=parent)  # Its mode is 0700.
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def run_as_processes(
    preparation: Preparation,
    folder: RunFolder,
    view: View,
    began_at: float,
    server: ForkServer,
) -> RunDocument:
    """Run and record a plant as processes over Zenoh, which the server starts.

    The user asked for it at `began_at`, monotonic [s].
    """
    base_port, plan = preparation.options.base_port, preparation.plan
    take_files(len(plan.processes))
    refused = refusals(plan.supervision.machine, lockstep=plan.timing.lockstep)
    for line in refused:
        view.say(line)
    with (
        GatewayProcess(plan) if plan.site.devices else nullcontext() as gateway,
        reserved_ports(
            listening(plan), base_port, plan.access.address, plan.access.external
        ) as tcp_ports,
        private_folder() as sockets,
        interruptible() as interruption,
    ):
        plan = folder.fill(preparation, tcp_ports, "" if plan.access.keys_folder else sockets)
        remarks = (*preparation.remarks, *refused)
        preparation = dataclasses.replace(preparation, plan=plan, remarks=remarks)
        if gateway is not None:
            gateway.join(folder.path)
        own = tuple(agent for agent in plan.processes if agent not in plan.elsewhere)
        address = preparation.options.operator
        try:
            with (
                Processes(server, plan, own, folder, view.say) as processes,
                PlantUnitProcess(address, folder.path) if address else nullcontext() as unit,
            ):
                return _Launch(
                    preparation, folder, began_at, view, processes, gateway, unit, interruption
                ).run()
        except FailureError as failure:
            with suppress(OSError):  # The disk may be full: that must not hide the failure.
                folder.failure.write_text(f"{failure}\n", encoding="utf-8")
            raise
        finally:  # A plant that was killed has left it.
            (folder.path / SOCKET_NAME).unlink(missing_ok=True)
