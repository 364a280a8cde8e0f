"""`heliarch launch`: a plant as a team of processes, from start to summary."""

from __future__ import annotations

import time
from contextlib import nullcontext, suppress
from dataclasses import replace
from typing import Final

from agents.plan import RunPlan
from agents.process.events import (
    Armed,
    Complaint,
    Event,
    Over,
    Recorded,
    RecordingEnded,
    Status,
    TookOver,
)
from agents.process.interruption import Interruption, interruptible
from agents.process.machine import refusals
from bus_schemas.errors import FailureError, InputError, listed
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import PLANT, RECORDER, agent_of
from launch_scripts.account import RunAccount
from launch_scripts.directions import directions
from launch_scripts.fork_requests import Start
from launch_scripts.restarts import Restarts
from launch_scripts.run_folder import RunFolder
from launch_scripts.supervision import Children, ForkServerProcess, RunFailure, stall
from launch_scripts.view import View
from launch_scripts.watch import HEARTBEAT_S, Watch
from results.run_summary import RunSummary
from scenarios.elsewhere import check_devices, listening
from scenarios.preparation import Preparation
from sunspec.process import GatewayProcess

_PLANT_PATIENCE_S: Final = 30.0
"""How long the plant waits for processes to appear."""

_ARMING_S: Final = 60.0
"""How long it may take from the command to cycle 0. The plant gives up before that by itself."""

_PATIENCE_S: Final = 5.0
"""How long processes may take to end once the run is over."""

_PER_PROCESS_S: Final = 0.1
"""How much longer each of these may take for each process."""

_GATHER_S: Final = 0.5
"""After the first event of a stall: time for the others to say what they wait for."""

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
        interruption: Interruption,
    ) -> None:
        self._account = account
        self._view = view
        self._children = children
        self._gateway = gateway
        self._interruption = interruption
        plan = account.preparation.plan
        self._watch = Watch(plan, children.rows, view.say)
        self._restarts = Restarts(plan, children, self._watch, self._start_again, view.say)
        self._started_at = time.monotonic()
        self._stalled_at: float | None = None
        self._stop_asked_at: float | None = None
        self._over: Over | None = None

    @property
    def _plan(self) -> RunPlan:
        return self._account.preparation.plan

    @property
    def _is_armed(self) -> bool:
        return self._account.armed_at > 0.0

    @property
    def _external_s(self) -> float:
        """How long external agents are waited for [s]."""
        return self._account.preparation.options.external_timeout_s if self._plan.elsewhere else 0.0

    def run(self) -> RunSummary:
        """Start the processes, see them through the run, compare what they say at its end."""
        children, account, plan = self._children, self._account, self._plan
        path = account.folder.plan
        if plan.timing.lockstep and plan.supervision.standby:
            self._view.say("no standby in lockstep, where nothing has a deadline: give a --pace")
        self._view.say(
            f"starting {len(children.by_agent)} processes, logs in {account.folder.logs}"
        )
        for line in directions(plan, path, self._external_s):
            self._view.say(line)
        self._start(tuple(children.by_agent))
        try:
            self._follow()
        except FailureError as failure:
            if not self._watch.unheard:
                raise
            # An external agent is the likely cause, and all others wait for it.
            keys = listed(self._watch.unheard)
            text = f"no answer to the arming rounds came on {keys}\n{failure}"
            raise RunFailure(text) from failure
        ended_at = time.monotonic()
        self._restarts.end()
        # A process that was away at the end did not hear the stop.
        children.ask_to_end([name for name in self._restarts.counts if name != RECORDER])
        recorded = self._finish()
        for child in children:
            account.add_process(child)
        account.restarts = self._restarts.counts
        # In real time the last cycle lasts to its end, though all have done their part before.
        cycles_s = recorded.cycles * plan.timing.cycle_wall_ns / 1e9
        return account.summary(
            recorded,
            max(ended_at - account.armed_at, cycles_s),
            interrupted=bool(self._interruption),
            devices=self._gateway.end() if self._gateway is not None else (),
        )

    def _start(self, agents: tuple[str, ...], *, again: bool = False, starts: int = 0) -> None:
        patience_s = _PLANT_PATIENCE_S + _PER_PROCESS_S * len(agents) + self._external_s
        folder = self._account.folder
        request = Start(str(folder.plan), agents, str(folder.logs), patience_s, again, starts)
        self._children.server.ask(request)

    def _start_again(self, agent: str) -> None:
        self._start((agent,), again=True, starts=self._restarts.counts[agent])
        if agent == RECORDER:
            self._watch.begin()

    def _follow(self) -> None:
        """Show the run until the plant says that it is over."""
        while not self._is_over():
            for child, event in self._children.events(0.1):
                self._hear(event)
                self._watch.hear(event)
                self._restarts.hear(child, event)
                if isinstance(event, TookOver):
                    self._account.takeovers[agent_of(child.agent)] += 1
            if self._gateway is not None:
                self._gateway.look(self._view.say)
            self._restarts.look()
            self._check_progress()
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

    def _hear(self, event: Event) -> None:
        match event:
            case Armed():
                self._account.armed_at = time.monotonic()
                for child in self._children:
                    child.cpu_at_start_s = child.cpu_s()
                self._watch.begin()
                self._restarts.begin(event.start_time_ns / 1e9)
                took_s = self._account.armed_at - self._started_at
                self._view.say(
                    f"armed: cycle 0 began {took_s:.2f} s after the processes were started"
                )
            case Status():
                for child in self._children:
                    if child.waiting is not None and event.cycle > child.waiting.cycle:
                        child.waiting = None  # It has gone on meanwhile.
                self._view.show(event)
            case Over():
                self._over = event
            case Complaint():
                self._view.say(f"wrong message on {event.key}: {event.example}")
            case RecordingEnded():
                self._view.say(f"{event.text}; the run goes on without it")

    def _check_progress(self) -> None:
        children, now = self._children, time.monotonic()
        if not self._is_armed:
            self._check_arming(now)
        waiting = [child for child in children if child.waiting is not None]
        self._stalled_at = (self._stalled_at or now) if waiting else None
        if self._stalled_at is not None and now > self._stalled_at + _GATHER_S:
            line, to_blame = stall(children)
            # While the recorder stands still, everybody waits for it.
            is_unresponsive = self._watch.rows[RECORDER].unheard_s > HEARTBEAT_S
            if not is_unresponsive and not self._restarts.mends(to_blame):
                raise children.failure(to_blame[0], line)
            for child in waiting:
                child.waiting = None
        if self._is_armed and (failure := self._watch.failure()) is not None:
            raise children.failure(*failure)

    def _check_arming(self, now: float) -> None:
        children, complete_at = self._children, self._watch.complete_at
        if complete_at is None:
            if now > self._started_at + self._external_s:
                raise RunFailure(
                    f"no sign of {', '.join(self._watch.awaited)} after {self._external_s:g} s: no "
                    f"liveliness token was seen; the lines above and {self._account.folder.plan} "
                    "say where a device finds the bus"
                )
            return
        longest_s = _ARMING_S + _PER_PROCESS_S * len(children.by_agent)
        if now > complete_at + longest_s:
            absent = next((child.agent for child in children if not child.ready), PLANT)
            raise children.failure(absent, f"not armed after {longest_s:.0f} s: see {absent}")

    def _ask_stop(self) -> None:
        """Let the plant end the run; lose patience after a while, or at the second Ctrl-C."""
        children, now = self._children, time.monotonic()
        if not self._is_armed:
            raise KeyboardInterrupt  # There is no cycle yet that could be completed.
        if self._stop_asked_at is None:
            self._restarts.end()
            self._view.say("interrupted: ending after this cycle")
            own_plant = [PLANT] if PLANT in children.by_agent else None
            children.ask_to_end(own_plant or [child.agent for child in children.controllers()])
            self._stop_asked_at = now
        longest_s = _PATIENCE_S + 2.0 * self._plan.timing.cycle_wall_ns / 1e9
        if self._interruption.count > 1 or now > self._stop_asked_at + longest_s:
            raise KeyboardInterrupt

    def _finish(self) -> Recorded:
        """Wait until all agents have ended; then let the recorder close its file."""
        children, account, recorder = self._children, self._account, self._children[RECORDER]
        longest_s = _PATIENCE_S + _PER_PROCESS_S * len(children.by_agent)
        is_early = self._over is not None and self._over.cycle < self._plan.timing.cycles
        if self._interruption or is_early:
            # After an early end, a controller waits in case the plant goes on after all.
            children.ask_to_end([child.agent for child in children.controllers()])
        if late := [
            child.agent for child in children.await_exit(children.controllers(), longest_s)
        ]:
            unheard_s = time.monotonic() - recorder.row.looked_at
            if unheard_s > HEARTBEAT_S:  # In lockstep all agents wait for it.
                text = f"recorder has been unresponsive for {unheard_s:.0f} s"
                raise children.failure(RECORDER, text)
            raise children.failure(late[0], f"{listed(late)} did not end with the run")
        for child in children.controllers():
            # A standby of an external agent is not the launcher's to account for.
            if child.finished and agent_of(child.agent) not in self._plan.elsewhere:
                account.published.update(child.finished.published)
        account.is_complete = not self._restarts.lost_processes
        # It is unknown what a process that died had published: wait until nothing more comes.
        children.end_recorder(account.published.total() if account.is_complete else _UNKNOWN)
        if children.await_exit([recorder], 2.0 * longest_s) or recorder.recorded is None:
            raise children.failure(RECORDER, "the recorder did not close its file")
        return recorder.recorded


def check_processes(plan: RunPlan) -> None:
    """Refuse what a run as processes cannot have."""
    if plan.timing.lockstep and plan.faults.rules:
        raise InputError(
            "--fault, faults: expected a --pace such as 1 with faults, got lockstep, where an "
            "agent would wait forever for a lost message"
        )
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
        try:
            with Children(server, plan, own, folder.logs) as children:
                return _Launch(account, view, children, gateway, interruption).run()
        except FailureError as failure:
            with suppress(OSError):  # The disk may be full: that must not hide the failure.
                folder.failure.write_text(f"{failure}\n", encoding="utf-8")
            raise
