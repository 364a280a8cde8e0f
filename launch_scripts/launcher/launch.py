"""`heliarch launch`: a plant as a team of processes, from start to summary."""

from __future__ import annotations

import time
from contextlib import nullcontext, suppress
from dataclasses import replace
from typing import Final

from agents.events import (
    Armed,
    Complaint,
    Event,
    Over,
    Presence,
    Recorded,
    RecordingEnded,
    Status,
)
from agents.machine import refusals
from agents.plan import RunPlan
from bus_schemas.errors import FailureError, InputError
from bus_schemas.tree import PLANT, RECORDER, agent_of, some_of
from launch_scripts.launcher.external_watch import ExternalWatch, directions
from launch_scripts.launcher.fork_requests import Start
from launch_scripts.launcher.interruption import Interruption, interruptible
from launch_scripts.launcher.live_view import View
from launch_scripts.launcher.restarts import Restarts
from launch_scripts.launcher.run_folder import RunFolder
from launch_scripts.launcher.run_watch import HEARTBEAT_S, RunWatch
from launch_scripts.launcher.summary import (
    RunSummary,
    count_messages,
    memory_use,
    merge_counts,
    process_account,
    published_at_least,
    recorded_health,
    recorded_metrics,
    without_external,
    wrong_messages,
)
from launch_scripts.launcher.supervision import (
    Children,
    ForkServerProcess,
    RunFailure,
    stall,
)
from launch_scripts.launcher.tcp_ports import reserved_ports
from launch_scripts.scenarios.devices import check_devices
from launch_scripts.scenarios.externals import listening
from launch_scripts.scenarios.preparation import Preparation
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
        preparation: Preparation,
        folder: RunFolder,
        view: View,
        began_at: float,
        server: ForkServerProcess,
        gateway: GatewayProcess | None,
    ) -> None:
        self._server = server
        self._gateway = gateway
        self._preparation = preparation
        plan = self._plan = preparation.plan
        self._folder = folder
        self._view = view
        self._began_at = began_at
        self._patience_s = preparation.options.external_timeout_s if plan.elsewhere else 0.0
        self._started_at = self._armed_at = began_at
        self._watch = RunWatch(plan, view.say)
        self._stalled_at: float | None = None
        self._asked_at: float | None = None
        self._is_armed = False
        self._over = self._ended_early = False
        self._external = ExternalWatch(plan, folder.plan, self._patience_s, time.monotonic())
        self._interruption = Interruption()

    def run(self) -> RunSummary:
        """Start the processes, see them through the run, compare what they say at its end."""
        plan, view = self._plan, self._view
        refused = refusals(plan.machine, lockstep=plan.lockstep)
        agents = tuple(agent for agent in plan.processes if agent not in plan.elsewhere)
        if plan.lockstep and plan.standby:
            view.say("no standby in lockstep, where nothing has a deadline: give a --pace")
        for line in (
            *refused,
            f"starting {len(agents)} processes, logs in {self._folder.logs}",
            *directions(plan, self._folder.plan, self._patience_s),
        ):
            view.say(line)
        with (
            interruptible() as self._interruption,
            Children(self._server, plan, agents, self._folder.logs) as children,
        ):
            self._restarts = Restarts(plan, children, self._start_again, view.say)
            self._started_at = time.monotonic()
            self._start(agents)
            try:
                self._follow(children)
            except FailureError as failure:
                raise RunFailure(self._external.explain(str(failure))) from failure
            ended_at = time.monotonic()
            self._restarts.end()
            # Who was away as the plant ended the run has not heard of it.
            children.ask_to_end([name for name in self._restarts.counts if name != RECORDER])
            recorded = self._finish(children)
            return self._summary(children, recorded, ended_at, refused)

    def _start(self, agents: tuple[str, ...], *, again: bool = False) -> None:
        patience_s = _PLANT_PATIENCE_S + _PER_PROCESS_S * len(agents) + self._patience_s
        logs = str(self._folder.logs)
        self._server.ask(Start(str(self._folder.plan), agents, logs, patience_s, again))

    def _start_again(self, agent: str) -> None:
        self._start((agent,), again=True)
        if agent == RECORDER:
            self._watch.begin(time.monotonic())

    def _follow(self, children: Children) -> None:
        """Show the run until the plant says that it is over."""
        while not self._is_over(children):
            for child, event in children.events(0.1):
                self._hear(event, children)
                self._restarts.hear(child, event)
            if self._gateway is not None:
                self._gateway.look(self._view.say)
            self._restarts.look(self._watch.recorder_silent_s)
            self._check_progress(children)
            if self._interruption:
                self._ask_stop(children)

    def _is_over(self, children: Children) -> bool:
        """Whether the run is over; for an external plant the recorder says so."""
        if PLANT in children.by_agent:
            return children[PLANT].finished is not None
        # Nobody can stop an external plant: after Ctrl-C the controllers end by themselves.
        left = [child for child in children.controllers() if child.finished is None]
        return self._over or (self._asked_at is not None and not left)

    def _hear(self, event: Event, children: Children) -> None:
        now = time.monotonic()
        match event:
            case Armed():
                self._armed_at = now
                for child in children:
                    child.cpu_at_start_s = child.cpu_s()
                self._watch.begin(now)
                self._restarts.begin(event.start_time_ns / 1e9)
                self._is_armed = True
                took_s = now - self._started_at
                self._view.say(
                    f"armed: cycle 0 began {took_s:.2f} s after the processes were started"
                )
            case Status():
                self._watch.hear(event.cycle)
                for child in children:
                    if child.waiting is not None and event.cycle > child.waiting.cycle:
                        child.waiting = None  # It has gone on meanwhile.
                self._external.unheard = event.unheard
                self._view.show(event)
            case Presence():
                self._view.say(self._external.hear(event, now))
            case Over():
                self._over = True
                self._ended_early = event.cycle < self._plan.cycles
            case Complaint():
                self._view.say(f"wrong message on {event.key}: {event.example}")
            case RecordingEnded():
                self._view.say(f"{event.text}; the run goes on without it")

    def _check_progress(self, children: Children) -> None:
        now = time.monotonic()
        if not self._is_armed:
            self._check_arming(children, now)
        waiting = [child for child in children if child.waiting is not None]
        self._stalled_at = (self._stalled_at or now) if waiting else None
        if self._stalled_at is not None and now > self._stalled_at + _GATHER_S:
            line, to_blame = stall(children)
            # While the recorder stands still, everybody waits for it.
            is_silent = self._watch.recorder_silent_s > HEARTBEAT_S
            if not is_silent and not self._restarts.mends(to_blame):
                raise children.failure(to_blame[0], line)
            for child in waiting:
                child.waiting = None
        if self._is_armed and (trouble := self._watch.check(now)) is not None:
            raise children.failure(*trouble)
        for agent, gone_at in self._external.gone.items():
            if self._is_armed and now > gone_at + HEARTBEAT_S:
                raise RunFailure(f"{agent} (external) is gone: the run cannot go on without it")

    def _check_arming(self, children: Children, now: float) -> None:
        if late := self._external.late(now):
            raise RunFailure(late)
        complete_at = self._external.complete_at
        longest_s = _ARMING_S + _PER_PROCESS_S * len(children.by_agent)
        if complete_at is not None and now > complete_at + longest_s:
            absent = next((child.agent for child in children if not child.ready), PLANT)
            raise children.failure(absent, f"not armed after {longest_s:.0f} s: see {absent}")

    def _ask_stop(self, children: Children) -> None:
        """Let the plant end the run; lose patience after a while, or at the second Ctrl-C."""
        if not self._is_armed:
            raise KeyboardInterrupt  # There is no cycle yet that could be completed.
        if self._asked_at is None:
            self._restarts.end()
            self._view.say("interrupted: ending after this cycle")
            own_plant = [PLANT] if PLANT in children.by_agent else None
            children.ask_to_end(own_plant or [child.agent for child in children.controllers()])
            self._asked_at = time.monotonic()
        longest_s = _PATIENCE_S + 2.0 * self._plan.cycle_wall_ns / 1e9
        if self._interruption.count > 1 or time.monotonic() > self._asked_at + longest_s:
            raise KeyboardInterrupt

    def _finish(self, children: Children) -> Recorded:
        """Wait until all agents have ended; then let the recorder close its file."""
        longest_s = _PATIENCE_S + _PER_PROCESS_S * len(children.by_agent)
        if self._interruption or self._ended_early:
            # After an early end, a controller waits in case the plant goes on after all.
            children.ask_to_end([child.agent for child in children.controllers()])
        if late := [
            child.agent for child in children.await_exit(children.controllers(), longest_s)
        ]:
            silent_s = time.monotonic() - children[RECORDER].heard_at
            if silent_s > HEARTBEAT_S:  # In lockstep all agents wait for it.
                raise children.failure(RECORDER, f"recorder has been silent for {silent_s:.0f} s")
            raise children.failure(late[0], f"{some_of(late)} did not end with the run")
        published = self._published(children)
        recorder = children[RECORDER]
        # What a process that died has published nobody knows: wait until nothing more comes.
        total = _UNKNOWN if self._restarts.lost_processes else sum(published.values())
        children.end_recorder(total)
        if children.await_exit([recorder], 2.0 * longest_s) or recorder.recorded is None:
            raise children.failure(RECORDER, "the recorder did not close its file")
        return recorder.recorded

    def _published(self, children: Children) -> dict[str, int]:
        """Return what the processes have published, by signal; a standby of an external one not."""
        own = [child for child in children if agent_of(child.agent) not in self._plan.elsewhere]
        return merge_counts(child.finished.published for child in own if child.finished)

    def _summary(
        self, children: Children, recorded: Recorded, ended_at: float, refused: tuple[str, ...]
    ) -> RunSummary:
        """Bring together what processes, recorder and launcher know of the run."""
        plan, cycles = self._plan, recorded.cycles
        accounts = [child.finished for child in children if child.finished is not None]
        processes = tuple(map(process_account, children))
        dropped = merge_counts(process.dropped for process in processes)
        if recorded.foreign:
            dropped["at the recorder"] = recorded.foreign
        health = recorded_health(self._folder.recording, plan)
        published, heard = self._published(children), without_external(recorded)
        if self._restarts.lost_processes:
            published = published_at_least(published, heard, health, plan)
        return RunSummary(
            run_id=plan.run_id,
            scenario=plan.plant,
            driver="launch",
            folder=str(self._folder.path),
            sim_start=self._preparation.local_start(),
            cycles=cycles,
            cycle_s=plan.cycle_ns / 1e9,
            # In real time the last cycle lasts to its end, though all have done their part before.
            wall_s=max(ended_at - self._armed_at, cycles * plan.cycle_wall_ns / 1e9),
            startup_s=self._armed_at - self._began_at,
            metrics=recorded_metrics(self._folder.recording),
            messages=count_messages(published, heard),
            restarts=dict(self._restarts.counts),
            takeovers=dict(self._restarts.takeovers),
            dropped=dropped,
            missing_inputs=health.missing_inputs if health else 0,
            memory=memory_use(
                # A short run may be over before all were looked at.
                (child.kind, child.memory)
                for child in children
                if child.memory.resident_mb
            ),
            hindsight_neighbours=self._preparation.hindsight,
            remarks=(*self._preparation.remarks, *refused),
            interrupted=bool(self._interruption),
            recording_ended=recorded.ended_early,
            faults=health.faults if health else {},
            skipped_cycles=sum(process.skipped_cycles for process in processes),
            processes=processes,
            external=recorded.external,
            devices=self._gateway.end() if self._gateway is not None else (),
            wrong=wrong_messages(
                plan, recorded.complaints, [one for account in accounts for one in account.dropped]
            ),
            health=health,
        )


def check_processes(plan: RunPlan) -> None:
    """Refuse what a run as processes cannot have."""
    if plan.lockstep and plan.faults:
        raise InputError(
            "--fault, faults: expected a --pace such as 1 with faults, got lockstep, where an "
            "agent would wait forever for a lost message"
        )
    check_devices(plan)
    if plan.keys_folder:
        from launch_scripts.scenarios.plant_keys import check_keys  # noqa: PLC0415 - optional

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
    plan, base_port = preparation.plan, preparation.options.base_port
    agents, further = listening(plan)
    further_port = None if base_port is None else base_port + len(agents)
    with (
        GatewayProcess(plan) if plan.devices else nullcontext() as gateway,
        reserved_ports(agents, base_port, plan.address) as tcp_ports,
        reserved_ports(further, further_port, plan.address) as agent_ports,
    ):
        plan = folder.fill(preparation, tcp_ports, agent_ports)
        preparation = replace(preparation, plan=plan)
        if gateway is not None:
            gateway.join(folder.path)
        try:
            return _Launch(preparation, folder, view, began_at, server, gateway).run()
        except FailureError as failure:
            with suppress(OSError):  # The disk may be full: that must not hide the failure.
                folder.failure.write_text(f"{failure}\n", encoding="utf-8")
            raise
