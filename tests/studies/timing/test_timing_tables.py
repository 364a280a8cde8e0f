"""The tables of a run show every figure, and the verdict names what was not kept."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace
from printing import printed
from reports_by_hand import missed, reported, summary_of
from timed_recordings import PLAN, cycle, recorded, without

from agents.events import ExternalAccount
from agents.machine import MachineSettings
from recordings.inspect.health import WrongMessages
from studies.report.result import print_result
from studies.timing.report import TimingReport, report_on
from studies.timing.results import timing_result


def text_of(found: TimingReport) -> str:
    return printed(lambda console: print_result(console, timing_result(found)))


def row(text: str, name: str) -> list[str]:
    """The figures of the first row of this name."""
    return str(re.findall(rf"^{name} +(\d.*?) *$", text, re.MULTILINE)[0]).split()


def test_each_row_has_its_figures_its_budget_and_its_verdict(tmp_path: Path) -> None:
    text = text_of(reported(tmp_path, budgets="hop_p99_ms = { residual = 0.45 }"))
    count, *times_ms, limit_ms, verdict = row(text, "residual")
    assert (count, limit_ms, verdict) == ("6", "0.450", "FAIL")
    assert [float(time) for time in times_ms] == pytest.approx([0.3, 0.4, 0.5, 0.5, 0.5], rel=0.01)
    assert row(text, "central solve")[-2:] == ["11.250", "PASS"]


def test_counts_and_resources_are_added_up_by_tier(tmp_path: Path) -> None:
    missing = {
        "c1/a/help": ("c1/a/telemetry", "dispatch"),
        "c1/a/command": ("dispatch@0",),
        "c2/c/residual": ("c2/c/telemetry",),
    }
    silent = without("c2/d/impp", "c2/d/residual", "c2/d/command")
    cycles = cycle(0), cycle(1, missing=missing), cycle(2, silent)
    report = reported(tmp_path, *cycles, dropped=2)
    tiers = {tier.tier: tier for tier in report.tiers}
    direct, recorder = tiers["direct"], tiers["recorder"]
    assert (direct.processes, direct.missed_deadlines, direct.skipped_cycles) == (4, 2, 1)
    assert (direct.missing_inputs, direct.old_inputs, direct.dropped) == (3, 1, 8)
    # Each process took 1 s of 10 s, and 40 MB.
    assert (direct.cpu_percent, direct.cpu_highest_percent) == pytest.approx((40.0, 10.0))
    assert (direct.resident_mb, recorder.resident_mb) == (40.0, 40.0)
    assert (recorder.processes, recorder.missed_deadlines) == (1, 0)


def test_without_a_summary_what_only_the_launcher_knew_is_not_zero(tmp_path: Path) -> None:
    report = report_on(recorded(tmp_path, cycle(0), cycle(1)))
    assert report.passed
    lines = {verdict.line for verdict in report.verdicts}
    assert not lines & {"messages not recorded", "dropped messages", "CPU of a direct"}
    text = text_of(report)
    assert row(text, "direct").count("-") == 4
    assert "summary.json" in text
    document = json.loads(msgspec.json.encode(report.document()))
    assert document["lost_messages"] is None
    assert document["tiers"][0]["cpu_percent"] is None
    assert document["processes"][0]["dropped"] is None


def test_the_summary_beside_a_recording_is_used_if_it_is_of_that_run(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    live = reported(folder, dropped=2)
    assert live.tiers[0].cpu_percent == pytest.approx(10.0)
    summary = summary_of(folder, dropped=2).as_json()
    (folder / "summary.json").write_bytes(summary)
    later = report_on(folder)
    assert (later.tiers, later.processes) == (live.tiers, live.processes)
    (folder / "summary.json").write_bytes(summary.replace(b"by-hand-2", b"another"))
    assert report_on(folder / "run.mcap").tiers[0].cpu_percent is None


@pytest.mark.parametrize(
    ("machine", "remarks", "scheduling"),
    [
        (MachineSettings(), (), "normal"),
        (MachineSettings(priority=20), ("priority 20: no SCHED_FIFO here",), "normal"),
        (
            MachineSettings(cpus=(0,), cpus_of={"direct": (1,)}, priority=7),
            (),
            "SCHED_FIFO 7, direct on CPU 1, others on CPU 0",
        ),
    ],
)
def test_the_host_tells_what_was_asked_for_and_not_refused(
    machine: MachineSettings, remarks: tuple[str, ...], scheduling: str, tmp_path: Path
) -> None:
    recorded(tmp_path, cycle(0), plan=replace(PLAN, machine=machine))
    found = report_on(tmp_path, replace(summary_of(tmp_path), remarks=remarks))
    host = found.host
    assert host.scheduling == scheduling
    assert (host.cpus, host.load_before) == (os.cpu_count(), None)
    text = text_of(replace(found, host=replace(host, load_before=1e6)))
    assert "busy before the run" in text


def test_each_process_is_shown_if_asked_for(tmp_path: Path) -> None:
    assert "c2/d: estimate" not in text_of(reported(tmp_path / "tiers", cycle(0), missed(1)))
    text = text_of(reported(tmp_path / "each", cycle(0), missed(1), by_agent=True))
    # Slowest decision, CPU and memory, then the missed deadlines.
    assert row(text, "plant +plant")[3:] == ["1", "0", "0", "0"]
    assert row(text, "c2/d: estimate")[0] == "2"
    assert row(text, "c1/a: c1/a/telemetry")[0] == "2"


def test_an_external_device_and_its_wrong_messages_are_reported(tmp_path: Path) -> None:
    device = ExternalAccount("c2/d", {"command": 2}, lost=1, expected=6, answered=5)
    wrong = WrongMessages("c2/d/command", "not msgpack", 3, "b'x'")
    found = reported(tmp_path, plan=replace(PLAN, external=("c2/d",)))
    text = text_of(replace(found, external=(device,), wrong=(wrong,), faults={"lost": 4}))
    assert "external c2/d: answered 5 times of 6" in text
    assert "wrong c2/d/command, 3 times: not msgpack: b'x'" in text
    assert "4 lost" in text
    assert "c2/d estimate (from outside)" in text
