"""Tests a device in the plant's place by the recordings of runs that it conducts."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Final

import msgspec

from agents.plan import changed
from launch_scripts.launch import launch
from launch_scripts.run_folder import RunFolder
from launch_scripts.supervision import ForkServerProcess, RunFailure
from launch_scripts.view import ViewFor
from recordings.verify.verification import verify
from results.run_summary import RunSummary
from scenarios.preparation import Preparation
from studies.conformance.device import Device
from studies.conformance.requirements import OF_PLANT, Findings

CYCLES: Final = 60

FROZEN: Final = "freeze=c*,at=20s..23s"
"""What happens in the run in real time: commands come late, or not at all."""

_OF_NUMBERS: Final = frozenset({"undecodable", "out_of_range"})
"""Causes of messages that are wrong in what they say, not in when and where they come."""


def try_plant(
    preparation: Preparation, folder: RunFolder, device: Device, view_for: ViewFor
) -> Findings:
    """Let the device conduct a run in lockstep, and one in real time."""
    findings = Findings(OF_PLANT)
    plan = preparation.plan
    walls_ns = {"lockstep": 0} | (
        {} if plan.timing.lockstep else {"real-time": plan.timing.cycle_wall_ns}
    )
    for name, wall_ns in walls_ns.items():
        run_id, faults = f"{plan.run_id}-{name}", plan.faults.rules if wall_ns else ()
        one = msgspec.structs.replace(
            changed(plan, timing={"cycle_wall_ns": wall_ns}, faults={"rules": faults}),
            run_id=run_id,
        )
        its_folder = RunFolder(folder.path / name)
        its_preparation = replace(preparation, plan=one)
        device.start(its_folder.plan)
        findings.try_("token")
        try:
            with (
                ForkServerProcess() as server,
                view_for(one) as view,
            ):
                summary = launch(its_preparation, its_folder, view, time.monotonic(), server)
        except RunFailure as failure:
            text = str(failure).splitlines()[0]
            findings.fail("token" if "no sign of" in text else "stop", text)
            break
        _look(summary, its_folder, findings)
        device.end()
    return findings


def _look(summary: RunSummary, folder: RunFolder, findings: Findings) -> None:
    for name in ("arming", "cycles", "head", "bounds", "links", "stop"):
        findings.try_(name)
    (account,) = summary.external
    kind = "missing" if summary.launcher.skipped_cycles or summary.missing_inputs else "cycles"
    findings.try_(kind)
    if account.answered < account.expected:
        count = account.expected - account.answered
        findings.fail(kind, f"{count:,} of {account.expected:,} messages did not come")
    if account.lost:
        findings.fail("head", f"sequence: {account.lost:,} numbers are missing")
    for wrong in summary.launcher.wrong:
        of = "bounds" if wrong.cause in _OF_NUMBERS else "cycles"
        findings.fail(of, f"{wrong.key}: {wrong.cause}, {wrong.example}")
    found = verify(folder.path)
    if found.first is not None:
        agent, difference = found.first
        text = f"cycle {difference.cycle}: {agent} decides otherwise on what was recorded"
        findings.fail("links", text)
