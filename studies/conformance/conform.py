"""Launches a plant around a device in one situation after the other, and judges the recordings."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from agents.plan import changed
from agents.process.events import Status
from bus_schemas.bus import Cause
from bus_schemas.errors import FailureError, listed
from launch_scripts.fork_server_process import fork_server
from launch_scripts.launch import run_as_processes
from launch_scripts.run_folder import RunFolder
from recordings.verify.comparison import Equality
from results.run_document import RunDocument
from scenarios.preparation import Preparation
from sim_plant.profile import Profile
from studies.conformance.device import Device
from studies.conformance.judge import DeviceRun, judge
from studies.conformance.requirements import Failure, Findings
from studies.conformance.situations import AWAY, Script, in_lockstep, in_real_time, restart

CYCLES: Final = 60
"""Cycles of the weather that all launches have; longer ones repeat it."""

_STALL_S: Final = 5.0
"""How long a launch in lockstep waits for an answer."""
_ARMING_S: Final = 10.0
"""How long nothing may come on a key in arming rounds."""


@dataclass
class _Attendant:
    """The view of a launch, which sees to the device meanwhile.

    away: Cycles in which the device is killed and started again.
    """

    say: Callable[[str], None]
    device: Device
    plan: Path
    away: range
    silent_since: float = inf
    has_begun: bool = False
    was_killed: bool = False

    def show(self, status: Status) -> None:
        # The recorder is there: a device that cannot connect at once may wait for seconds.
        if not self.has_begun:
            self.has_begun = True
            self.device.start(self.plan)
        if status.cycle < 0 and self.device.end_text:
            raise FailureError(f"no sign of it: {self.device.end_text}")
        now = time.monotonic()
        self.silent_since = min(now, self.silent_since) if status.unheard else inf
        if now > self.silent_since + _ARMING_S:
            raise FailureError(f"in arming rounds nothing came on {listed(status.unheard)}")
        if status.cycle in self.away and not self.was_killed:
            self.was_killed = True
            self.device.end(0.0)
            self.device.start(self.plan)


@dataclass(eq=False)
class Conformance:
    """The situations of one device, each a launch in a folder of its own.

    `say` is called with lines for the user.
    """

    preparation: Preparation
    folder: RunFolder
    device: Device
    equality: Equality
    say: Callable[[str], None]

    def __post_init__(self) -> None:
        (self._agent,) = self.preparation.plan.access.external
        self.findings = Findings()

    def run(self, seed: int) -> Findings:
        """Take the device through all situations; stop if it never arms."""
        plan = changed(
            self.preparation.plan,
            timing={"stall_timeout_s": _STALL_S},
            access={"keys_folder": ""},
            faults={"rules": ()},
        )
        try:
            script = Script(changed(plan, timing={"cycle_wall_ns": 0}), self._agent, seed)
            in_lockstep(script)
            self._try("lockstep", script)
            if not plan.timing.lockstep:
                script = Script(plan, self._agent, seed)
                in_real_time(script)
                self._try("real-time", script, restarts=self.device.can_restart)
        except FailureError as failure:
            self.say(str(failure))
        return self.findings

    def _try(self, name: str, script: Script, *, restarts: bool = False) -> None:
        away = restart(script) if restarts else range(0)
        self._judge(script, *self._launch(name, script, away), away)
        self.device.end()

    def _launch(
        self, name: str, script: Script, away: range
    ) -> tuple[RunFolder, RunDocument | Exception]:
        """Launch the plant around the device; return the folder, and how it ended."""
        cycles, folder = script.cycle, RunFolder(self.folder.path / name)
        plan = changed(
            script.plan, timing={"cycles": cycles}, faults={"device": tuple(script.faults)}
        )
        preparation = dataclasses.replace(
            self.preparation,
            plan=msgspec.structs.replace(plan, run_id=f"{plan.run_id}-{name}"),
            profile=_of_cycles(self.preparation.profile, cycles),
        )
        view = _Attendant(self.say, self.device, folder.plan, away)
        self.findings.note("token", "PASS")
        try:
            with fork_server() as server:
                summary = run_as_processes(preparation, folder, view, time.monotonic(), server)
        except FailureError as failure:
            return folder, failure
        if summary.interrupted:
            raise KeyboardInterrupt
        return folder, summary

    def _judge(
        self,
        script: Script,
        folder: RunFolder,
        ended: RunDocument | Exception,
        away: range,
    ) -> None:
        """Judge a launch by its recording; raise its failure if it did not come to cycle 0."""
        recorded = DeviceRun.of(folder.path, self._agent)
        failure = "" if isinstance(ended, RunDocument) else str(ended).splitlines()[0]
        if not recorded.cycles:
            of = "token" if "no sign of" in failure else "arming"
            self.findings.fail(Failure(of, failure))
            raise FailureError(failure)
        shown = [*script.shows[: recorded.cycles], "stop"]
        for requirement in {"arming", "head", "bounds", "links", *shown} - {AWAY}:
            self.findings.note(requirement, "PASS")
        found = judge(recorded, self.equality, away.stop if away else None)
        last = recorded.cycles - 1
        if failure and all((one.cycle or 0) < last for one in found):
            found.append(Failure("links", f"cycle {last}: {failure}", last))
        for one in found:
            cycle = one.cycle or 0
            shows = shown[min(cycle, recorded.cycles)]
            requirement = one.requirement or shows
            if shows == AWAY:
                continue
            if recorded.slow_cycle is not None and cycle >= recorded.slow_cycle:
                text = f"the machine was too slow to judge from cycle {recorded.slow_cycle} on"
                self.findings.note(requirement, "too slow", f"{text}: lower --pace")
                continue
            inputs, trial = recorded.inputs_of(cycle), folder.path.name
            self.findings.fail(one._replace(requirement=requirement, trial=trial, inputs=inputs))
        for wrong in ended.wrong if isinstance(ended, RunDocument) else ():
            if wrong.cause in (Cause.UNDECODABLE, Cause.UNKNOWN, Cause.WRONG_SENDER):
                of = "bounds" if wrong.cause == Cause.UNDECODABLE else "decisions"
                text = f"{wrong.key}: {wrong.cause}, {wrong.example}"
                self.findings.fail(Failure(of, text, message=wrong.key))


def _of_cycles(profile: Profile, cycles: int) -> Profile:
    """Return a profile of this length [cycles]; a shorter one is repeated."""
    series: dict[str, Any] = {}
    for one in dataclasses.fields(profile):
        values = getattr(profile, one.name)
        if isinstance(values, np.ndarray) and values.size:
            series[one.name] = np.resize(values, (cycles, *values.shape[1:]))
    return dataclasses.replace(profile, **series)
