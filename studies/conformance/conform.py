"""Takes a device through all trials."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

from msgspec.structs import replace

from agents.plan import RunPlan, changed
from bus_schemas.errors import FailureError
from bus_schemas.messages import Message
from bus_schemas.signals import Occurrence, Port
from bus_schemas.tcp_ports import reserved_ports
from launch_scripts.directions import directions
from launch_scripts.run_folder import RunFolder
from launch_scripts.simulation import MemoryRun
from recordings.verify.equality import Equality
from scenarios.preparation import Preparation
from studies.conformance import situations
from studies.conformance.answers import Answers
from studies.conformance.device import Device
from studies.conformance.neighbours import Neighbours
from studies.conformance.requirements import REQUIREMENTS, Findings
from studies.conformance.situations import Situation
from studies.conformance.trial import Trial

CYCLES: Final = 240
"""Cycles that a trial has at most."""

_REJOIN_CYCLES: Final = 30


@dataclass(eq=False)
class Conformance:
    """The trials of one controller's device, in a run of `CYCLES` cycles.

    The folder has a folder for each trial; `say` is called with lines for the user.
    """

    preparation: Preparation
    folder: RunFolder
    device: Device
    equality: Equality
    say: Callable[[str], None]

    def __post_init__(self) -> None:
        (self._agent,) = self.preparation.plan.access.external
        self.findings = Findings(REQUIREMENTS)
        plan = changed(self.preparation.plan, faults={"rules": ()}, supervision={"standby": ()})
        self.preparation = dataclasses.replace(self.preparation, plan=plan)
        self._inputs = self._undisturbed()

    def run(self, seed: int) -> Findings:
        """Take the device through all situations; the first that cannot go on is the last."""
        plan = self.preparation.plan
        lockstep = changed(plan, timing={"cycle_wall_ns": 0})
        try:
            self._try("lockstep", lockstep, situations.IN_LOCKSTEP, seed)
            if not plan.timing.lockstep:
                self._try("real-time", plan, situations.IN_REAL_TIME, seed)
        except FailureError as failure:
            self.say(str(failure))
        return self.findings

    def _try(self, name: str, plan: RunPlan, of_run: Sequence[Situation], seed: int) -> None:
        options = self.preparation.options
        draw = random.Random(seed)
        with reserved_ports(plan.links.listening, options.base_port) as tcp_ports:
            folder = RunFolder(self.folder.path / name)
            its_plan = replace(plan, run_id=f"{plan.run_id}-{name}")
            own_plan = folder.fill(dataclasses.replace(self.preparation, plan=its_plan), tcp_ports)
            for line in directions(own_plan, folder.plan, options.external_timeout_s):
                self.say(line)
            with self._trial(own_plan, folder, "arming") as trial:
                for situation in of_run:
                    trial.show(situation.requirement)
                    situation.play(trial, draw)
                if not own_plan.timing.lockstep:
                    if self.device.can_restart:
                        self._restart(trial, folder, draw)
                    trial.stop()
            if own_plan.timing.lockstep:
                self._close_links(own_plan, folder, draw)
        self.device.end()

    @contextmanager
    def _trial(self, plan: RunPlan, folder: RunFolder, requirement: str) -> Iterator[Trial]:
        """Begin a run; that shows a requirement."""
        answers = Answers(plan, self._agent, self.findings, self.equality)
        with Neighbours(plan, self._agent) as neighbours:
            self.device.start(folder.plan)
            trial = Trial(plan, self._agent, self._inputs, neighbours, self.findings, answers)
            trial.requirement = requirement
            trial.begin(self.device, self.preparation.options.external_timeout_s)
            yield trial

    def _close_links(self, plan: RunPlan, folder: RunFolder, draw: random.Random) -> None:
        """Run once more, now that the links have closed."""
        try:
            with self._trial(plan, folder, "links closed") as trial:
                situations.undisturbed(trial, draw)
                trial.stop()
        except FailureError as failure:
            self.findings.fail("links closed", str(failure))
            self.device.kill()  # The next trial begins with a new process.

    def _restart(self, trial: Trial, folder: RunFolder, draw: random.Random) -> None:
        self.device.kill()
        trial.skip()
        trial.skip()
        self.device.start(folder.plan)
        trial.show("restart")
        if not any(trial.skip() for _ in range(_REJOIN_CYCLES)):
            self.findings.fail("restart", f"no answer in {_REJOIN_CYCLES} cycles")
            return
        situations.undisturbed(trial, draw)

    def _undisturbed(self) -> dict[int, dict[Port[Message], Message]]:
        """Return what our own agent hears in the run, cycle by cycle."""
        inputs: dict[int, dict[Port[Message], Message]] = {}
        heard = set(self.preparation.plan.wiring.heard[self._agent])

        def hear(port: Port[Message], message: Message) -> None:
            if port in heard and port.signal.occurrence is not Occurrence.EVENT:
                inputs.setdefault(message.cycle, {})[port] = message

        for _ in MemoryRun(self.preparation.plan, self.preparation.profile, hear).cycles():
            pass
        return inputs
