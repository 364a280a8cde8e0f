"""Tables and page of a timed run: every figure, the verdict, and what was not kept."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace
from printing import printed
from reports_by_hand import missed, reported, summary_of
from timed_recordings import PLAN, cycle, recorded, without

from agents.machine import MachineSettings
from recordings.inspect.health import WrongMessages
from studies.report.page import html_page
from studies.report.result import print_result
from studies.timing.report import TimingReport, report_on
from studies.timing.results import sweep_result, timing_result
from studies.timing.sweep import RateRow, Sweep


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
    recorded(tmp_path, cycle(0), plan=replace(PLAN, machine=machine))
    found = report_on(tmp_path, replace(summary_of(tmp_path), remarks=("memory: not locked",)))
    assert (found.host.cpus, found.host.load_before) == (os.cpu_count(), None)
    text = text_of(found)
    assert "SCHED_FIFO 7, direct on CPU 1, others on CPU 0" in text
    assert "memory: not locked" in text


def test_each_process_is_shown_if_asked_for(tmp_path: Path) -> None:
    assert "c2/d: " not in text_of(reported(tmp_path / "tiers", cycle(0), missed(1)))
    text = text_of(reported(tmp_path / "each", cycle(0), missed(1), by_agent=True))
    # A missed deadline and a missing input, then processor time and memory.
    assert row(text, "plant +plant") == ["1", "1", "0", "0", "0", "10.0", "40.0"]
    assert row(text, "c2/d: direct estimate")[0] == "2"
    assert row(text, "c1/a: telemetry")[0] == "2"


def test_an_external_device_and_its_wrong_messages_are_reported(tmp_path: Path) -> None:
    plan = replace(PLAN, external=("c2/d",))
    recorded(tmp_path, cycle(0), cycle(1), plan=plan)
    wrong = WrongMessages("c2/d/command", "not msgpack", 3, "b'x'")
    text = text_of(report_on(tmp_path, replace(summary_of(tmp_path, plan), wrong=(wrong,))))
    assert "3 not msgpack on c2/d/command" in text
    assert row(text, "c2/d estimate")[0] == "2"


# The page -----------------------------------------------------------------------------------------


def run_page(found: TimingReport) -> str:
    return html_page(timing_result(found))


def plot(page: str, anchor: str) -> dict[str, Any]:
    """Data and layout of a figure, as they stand in the page."""
    found = re.search(rf'id="{anchor}-plot-data">(.*?)</script>', page, re.DOTALL)
    assert found is not None, anchor
    document: dict[str, Any] = json.loads(found[1])
    return document


def names(drawn: dict[str, Any]) -> list[str]:
    return [trace["name"] for trace in drawn["data"]]


@pytest.fixture
def page(tmp_path: Path) -> str:
    return run_page(reported(tmp_path))


def test_the_page_begins_with_the_verdict_and_the_slowest_cycle(page: str, tmp_path: Path) -> None:
    verdict = page.index('<p class="verdict pass">PASS: all ')
    assert verdict < page.index("2 cycles") < page.index('<section id="waits-1"')
    assert re.findall(r'<section id="([a-z0-9-]+)"', page)[:4] == [
        "waits-1",
        "waits-2",
        "loop",
        "percentiles-loop",
    ]
    failed = run_page(reported(tmp_path / "late", cycle(0), missed(1)))
    assert '<p class="verdict fail">FAIL: ' in failed
    assert "not kept: " in failed


def test_the_loop_time_is_drawn_over_time_and_budgets_are_lines(page: str) -> None:
    drawn = plot(page, "loop")
    assert names(drawn) == ["loop time", "budget 50 ms"]
    assert list(drawn["data"][0]["x"]) == [0.0, 0.1]
    assert list(drawn["data"][0]["y"]) == [13.6, 13.6]
    hops = plot(page, "percentiles-hop")
    signals = ("telemetry", "residual", "setpoint", "command")
    assert names(hops) == [*(f"hop {signal}" for signal in signals), "budget 10 ms"]
    assert set(hops["data"][-1]["y"]) == {10.0}


def test_each_agent_has_a_row_and_the_chain_a_colour_of_its_own(page: str) -> None:
    drawn = plot(page, "waits-1")
    others, chain, messages = drawn["data"]
    assert list(chain["y"]) == ["plant", "c2/c", "c2", "central", "c2", "c2/d", "plant"]
    assert "c1/a" in list(others["y"])
    assert others["marker"]["color"] != chain["marker"]["color"]
    assert "c2/c took 7.9 ms (estimate)" in chain["customdata"][1]
    assert list(messages["y"])[:2] == ["plant", "c2/c"]
    rows = drawn["layout"]["yaxis"]["categoryarray"]
    assert rows == ["plant", "central", "c1", "c1/a", "c1/b", "c2", "c2/c", "c2/d"]


def test_the_page_of_a_sweep_draws_loop_time_against_rate(tmp_path: Path) -> None:
    report = reported(tmp_path)
    rows = (
        RateRow(5.0, "clean", "", 75, 0, 0, 9e3, 10e3, 12e3, report.host),
        RateRow(80.0, "not clean", "direct missed one", 300, 7, 0, 9e3, 30e3, 40e3),
        RateRow(90.0, "interrupted", "", 300, 0, 0, 9e3, 30e3, 40e3),
        RateRow(160.0, "failed", "recorder gave up"),
    )
    page = html_page(sweep_result(Sweep(rows, 5.0), "field"))
    assert '<p class="verdict pass">highest clean rate: 5 cycles/s' in page
    assert "160 cycles/s failed: recorder gave up" in page
    drawn = plot(page, "rates")
    assert names(drawn) == ["loop p50", "loop p99", "loop max", "length of a cycle"]
    assert list(drawn["data"][0]["marker"]["symbol"]) == ["circle", "x"]
    assert list(drawn["data"][0]["x"]) == [5.0, 80.0]
