"""The tables of a run fit into 100 columns, and name what was not kept."""

from __future__ import annotations

import io
import json
import re

import pytest
from msgspec.structs import replace
from rich.console import Console
from timings_by_hand import HOST, TIMINGS, encoded, report, timing

from agents.events import ExternalAccount
from launch_scripts.timing.budget_table import BudgetTable
from launch_scripts.timing.distributions import distribution, merged
from launch_scripts.timing.floor import FloorTimes
from launch_scripts.timing.timing_report import TimingReport
from launch_scripts.timing.timing_table import cycle_lines, print_report, verdict_line
from launch_scripts.wrong_messages import WrongMessages

FLOOR = (
    FloorTimes("timer", distribution(merged([encoded([0.05, 0.25])]))),
    FloorTimes("Zenoh round trip", None, "not measured: no answer"),
    FloorTimes("cyclictest", None, "not installed (rt-tests)"),
)


def printed(found: TimingReport, *, processes: bool = False, width: int = 100) -> list[str]:
    console = Console(file=io.StringIO(), width=width)
    print_report(found, console, processes=processes)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


def row(lines: list[str], name: str) -> str:
    """The figures of a row, with single spaces: what follows its name, up to a figure."""
    (figures,) = re.findall(rf"^  {name} +(\d.*?) *$", "\n".join(lines), re.MULTILINE)
    return " ".join(figures.split())


def test_each_row_has_its_figures_its_budget_and_its_verdict() -> None:
    lines = printed(report(table=BudgetTable(hop_p99_ms={"impp": 3.5}), floor=FLOOR))
    count, *times_us, limit_us, verdict = row(lines, "impp").replace(",", "").split()
    assert (count, limit_us, verdict) == ("3", "3500", "FAIL")
    told_us = [float(time_us) for time_us in times_us]
    assert told_us == pytest.approx([1000, 2000, 4000, 4000, 4000], rel=0.01)
    assert row(lines, "central solve").endswith(" 9,000 PASS")
    assert row(lines, "timer").startswith("2 50 ")
    assert max(map(len, lines)) <= 100
    headings = [line.partition(" ")[0] for line in lines if "[µs]" in line]
    assert headings == ["loop", "decision", "hop", "lateness", "jitter", "age", "floor"]


@pytest.mark.parametrize("width", [50, 80, 100, 200])
def test_however_narrow_a_terminal_is_verdicts_and_figures_are_all_there(width: int) -> None:
    found = report(table=BudgetTable(hop_p99_ms={"impp": 3.5}), floor=FLOOR)
    words = " ".join(printed(found, width=width)).split()
    wide = " ".join(printed(found, width=500)).split()
    figures = {word for word in wide if word[0].isdigit()}
    assert len(figures) > 20
    assert figures <= set(words)
    for verdict in ("PASS", "FAIL"):
        assert words.count(verdict) == wide.count(verdict)
    assert not any("…" in word for word in words)


def test_each_table_of_durations_has_headings() -> None:
    lines = printed(report(floor=FLOOR))
    titles = [place for place, line in enumerate(lines) if re.match(r"\w+ \[µs\]", line)]
    assert len(titles) == 7
    for place in titles:
        heading = " ".join(" ".join(lines[place + 1 : place + 3]).split())
        assert "count min p50 p99 p99.9 max" in heading


def test_a_device_with_an_old_clock_does_not_make_figures_that_cannot_be_read() -> None:
    old = timing("plant", {"loop": [3_607_772.0], "decision/begin": [1.0]})
    for width in (80, 100):
        lines = printed(report((old,)), width=width)
        assert " ".join(lines).split().count("3,600,000.0") == 5
        (line,) = [line for line in lines if line.startswith("  not kept: loop")]
        assert line == "  not kept: loop all commands p99 3,600,000.000 ms (at most 40.000 ms)"


def test_what_is_one_is_not_plural() -> None:
    device = ExternalAccount("c2/d", {"command": 1}, lost=1, expected=6, answered=1)
    wrong = WrongMessages("c2/d/command", "not msgpack", 1, "b'x'")
    found = replace(report(cycles=1), rate_hz=1.0, external=(device,), wrong=(wrong,))
    text = "\n".join(printed(found))
    assert "field at 1 cycle/s in real time: 1 cycle in" in text
    assert "answered 1 time of 6" in text
    assert "wrong c2/d/command, 1 time: not msgpack" in text


def test_figures_of_other_budgets_have_their_decimals() -> None:
    lines = printed(report())
    assert row(lines, "CPU of a plant") == "10.00 % 80.00 % PASS"


def test_locked_memory_is_told_beside_the_scheduling() -> None:
    locked = replace(HOST, memory_locked=True)
    assert "scheduling: other on CPU 0, 1" in printed(report())
    assert "scheduling: other on CPU 0, 1; memory locked" in printed(replace(report(), host=locked))


def test_a_machine_that_was_busy_beforehand_is_named_as_such() -> None:
    quiet, busy = report(), replace(report(), host=replace(HOST, load_before=2.5))
    assert not any("busy" in line for line in printed(quiet))
    assert any("the machine was busy before the run began" in line for line in printed(busy))


def test_what_could_not_be_measured_of_the_floor_is_said() -> None:
    text = "\n".join(printed(report(floor=FLOOR)))
    assert "  cyclictest: not installed (rt-tests)" in text
    assert "  Zenoh round trip: not measured: no answer" in text


def test_the_verdict_names_each_budget_that_was_not_kept() -> None:
    assert verdict_line(report()).startswith("PASS: all ")
    late = report((*TIMINGS[:-1], timing("c2/d", {}, missed=2)), lost=1)
    assert re.fullmatch(r"FAIL: 2 of \d+ budgets were not kept", verdict_line(late))
    lines = printed(late)
    assert lines[-2:] == [
        "  not kept: missed deadlines 2 (at most 0)",
        "  not kept: messages not recorded 1 (at most 0)",
    ]
    assert row(lines, "missed deadlines") == "2 0 FAIL"
    assert row(lines, "overruns") == "0 0 PASS"
    # processes, missed deadlines, missing inputs, late used, dropped, overruns
    assert row(lines, "direct").startswith("2 2 4 2 0 0 ")


def test_one_budget_was_not_kept_and_two_were_not() -> None:
    assert re.fullmatch(r"FAIL: 1 of \d+ budgets was not kept", verdict_line(report(lost=1)))


def test_it_is_said_that_the_links_of_a_slow_cycle_hold_hops() -> None:
    assert cycle_lines(report())[-1].endswith("the hop to it is part of its time)")
    assert cycle_lines(replace(report(), slowest_cycles=())) == []


def test_long_durations_are_told_in_milliseconds_in_all_columns() -> None:
    slow = timing("plant", {"loop": [25_000.0], "decision/begin": [1.0]})
    lines = printed(report((slow,)))
    assert any("loop [ms]" in line for line in lines)
    assert row(lines, "plant begin").startswith("1 1.0 1.0 ")
    assert not any("[µs]" in line for line in lines)


def test_each_process_is_shown_if_asked_for() -> None:
    late = (*TIMINGS[:-1], timing("c2/d", {"hop/c2/d/request": [1.0]}, missed=2))
    assert not any(line.startswith("c2/d (direct)") for line in printed(report(late)))
    lines = printed(report(late), processes=True)
    (heading,) = [place for place, line in enumerate(lines) if line.startswith("c2/d (direct)")]
    text = " ".join(" ".join(lines[heading : heading + 3]).split())
    assert "missed estimate 2; missing c1/a/request 4" in text
    assert row(lines, "hop c2/d/request").startswith("1 ")
    assert max(map(len, lines)) <= 100


def test_cycles_that_were_given_up_are_told_by_tier_and_process() -> None:
    found = report()
    behind = replace(found.processes[1], cycles_given_up=9)
    tiers = [
        replace(tier, cycles_given_up=9 if tier.tier == "central" else 0) for tier in found.tiers
    ]
    found = replace(found, processes=(behind,), tiers=tuple(tiers))
    lines = printed(found, processes=True)
    # processes, missed deadlines, missing inputs, late used, dropped, overruns, given up
    assert row(lines, "central").startswith("1 0 0 0 0 0 9 ")
    assert "9 cycles given up" in " ".join(lines)
    assert not found.clean
    assert json.loads(found.as_json())["tiers"][1]["cycles_given_up"] == 9


def test_a_foreign_device_and_its_wrong_answers_are_told() -> None:
    device = ExternalAccount("c2/d", {"command": 2}, lost=1, expected=6, answered=5)
    wrong = WrongMessages("c2/d/command", "not msgpack", 3, "b'x'")
    found = replace(report(), external=(device,), wrong=(wrong,), faults={"lost": 4})
    text = "\n".join(printed(found))
    assert "external c2/d: answered 5 times of 6, 1 of its messages never came or could" in text
    assert "wrong c2/d/command, 3 times: not msgpack: b'x'" in text
    assert "faults of the network, as was asked for: 4 lost" in text


def test_the_document_has_all_rows_and_histograms_that_others_can_merge() -> None:
    document = json.loads(report(floor=FLOOR).as_json())
    assert (document["passed"], document["clean"]) == (True, True)
    impp = next(entry for entry in document["times"] if entry["of"] == "impp")
    assert impp["times"]["count"] == 3
    assert merged([impp["times"]["histogram"]]).get_total_count() == 3
    assert {entry["line"] for entry in document["verdicts"]} >= {
        "hop impp p99",
        "messages not recorded",
    }
    assert [process["agent"] for process in document["processes"]][:2] == ["plant", "central"]
    assert document["floor"][0]["times"]["min_us"] < 51.0
    assert document["slowest_cycles"][0]["slowest_agent"] == "c2/d"
