"""Tables and page of a timed run: every figure, the verdict, and what was not kept."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import msgspec
import plotly.graph_objects as go
import pytest
from msgspec.structs import replace
from plans_by_hand import with_changes
from printing import printed
from reports_by_hand import missed, reported, summary_of
from timed_recordings import PLAN, cycle, recorded, without

from agents.process.machine import MachineSettings
from recordings.inspect.health import WrongMessages
from results.report.page import html_page
from results.report.result import print_result
from results.timing.report import TimingReport, report_on
from results.timing.results import timing_result


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
    assert (direct.missing_inputs, direct.dropped) == (3, 8)
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


def test_the_header_tells_what_was_asked_of_the_machine_and_what_it_refused(tmp_path: Path) -> None:
    machine = MachineSettings(cpus=(0,), cpus_of={"direct": (1,)}, priority=7)
    recorded(tmp_path, cycle(0), plan=with_changes(PLAN, machine=machine))
    wrong = WrongMessages("c2/d/command", "not msgpack", 3, "b'x'")
    summary = replace(summary_of(tmp_path), remarks=("memory: not locked",), wrong=(wrong,))
    found = report_on(tmp_path, summary)
    assert (found.host.cpus, found.host.load_before) == (os.cpu_count(), None)
    text = text_of(found)
    assert "SCHED_FIFO 7, direct on CPU 1, others on CPU 0" in text
    assert "memory: not locked" in text
    assert "3 not msgpack on c2/d/command" in text


def test_each_process_is_shown_if_asked_for(tmp_path: Path) -> None:
    assert "c2/d: " not in text_of(reported(tmp_path / "tiers", cycle(0), missed(1)))
    text = text_of(reported(tmp_path / "each", cycle(0), missed(1), by_agent=True))
    # A missed deadline and a missing input, then processor time and memory.
    assert row(text, "plant +plant") == ["1", "1", "0", "0", "0", "10.0", "40.0"]
    assert row(text, "c2/d: direct estimate")[0] == "2"
    assert row(text, "c1/a: telemetry")[0] == "2"


# The page -----------------------------------------------------------------------------------------


def figures_of(report: TimingReport) -> dict[str, go.Figure]:
    return {one.anchor: one.figure for one in timing_result(report).figures()}


def names(figure: go.Figure) -> list[str]:
    return [trace.name for trace in figure.data]


def test_the_page_begins_with_the_verdict_and_the_slowest_cycle(tmp_path: Path) -> None:
    page = html_page(timing_result(reported(tmp_path / "kept")))
    verdict = page.index('<p class="verdict pass">PASS: all ')
    assert verdict < page.index("2 cycles") < page.index('<section id="waits-1"')
    sections = re.findall(r'<section id="([a-z0-9-]+)"', page)
    assert sections[:4] == ["waits-1", "waits-2", "loop", "percentiles-loop"]
    failed = html_page(timing_result(reported(tmp_path / "late", cycle(0), missed(1))))
    assert '<p class="verdict fail">FAIL: ' in failed
    assert "not kept: " in failed


def test_the_loop_time_is_drawn_over_time_and_budgets_are_lines(tmp_path: Path) -> None:
    figures = figures_of(reported(tmp_path))
    assert names(figures["loop"]) == ["loop time", "budget 50 ms"]
    assert list(figures["loop"].data[0].x) == [0.0, 0.1]
    assert list(figures["loop"].data[0].y) == [13.6, 13.6]
    hops = figures["percentiles-hop"]
    signals = ("telemetry", "residual", "setpoint", "command")
    assert names(hops) == [*(f"hop {signal}" for signal in signals), "budget 10 ms"]
    assert set(hops.data[-1].y) == {10.0}


def test_each_agent_has_a_row_and_the_chain_a_colour_of_its_own(tmp_path: Path) -> None:
    drawn = figures_of(reported(tmp_path))["waits-1"]
    others, chain, messages = drawn.data
    assert list(chain.y) == ["plant", "c2/c", "c2", "central", "c2", "c2/d", "plant"]
    assert "c1/a" in list(others.y)
    assert others.marker.color != chain.marker.color
    assert "c2/c took 7.9 ms (estimate)" in chain.customdata[1]
    assert list(messages.y)[:2] == ["plant", "c2/c"]
    rows = drawn.layout.yaxis.categoryarray
    assert rows == ("plant", "central", "c1", "c1/a", "c1/b", "c2", "c2/c", "c2/d")
