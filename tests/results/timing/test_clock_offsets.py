"""Clocks of other hosts and devices, worked out from the times in a recording."""

from __future__ import annotations

from pathlib import Path

import pytest
from plans_by_hand import with_changes
from test_timing_results import row, text_of
from timed_recordings import MS, PLAN, TIMES_MS, cycle, recorded

from agents.plan import RunPlan
from bus_schemas.messages import Message
from recordings.read.reader import RunReader
from results.timing.report import report_on
from results.timing.run_timing import RunTiming, run_timing

HOST = "10.0.0.2"
AWAY = ("c2", "c2/c", "c2/d")
ON_TWO_HOSTS = with_changes(PLAN, addresses=dict.fromkeys(AWAY, HOST))

LATER_MS = {
    **{key: 40.0 for key in TIMES_MS if key.endswith("setpoint") or "command" in key},
    **{key: 20.0 for key in TIMES_MS if key.startswith("c2/") and "telemetry" not in key},
    **dict.fromkeys(("impp", "residual", "c2/setpoint"), 40.0),
    **{key: 60.0 for key in TIMES_MS if key.startswith(("c2/c/", "c2/d/")) and key[5] in "sc"},
    **dict.fromkeys(("c2/c/telemetry", "c2/d/telemetry"), 0.0),
    "production": 80.0,
}
"""How much later all happens if c2 is 20 ms away, there and back, twice in a cycle."""


def timed(folder: Path, ahead_ms: float, plan: RunPlan = ON_TWO_HOSTS) -> RunTiming:
    """A cycle in which c2 and its inverters are away, and their clock is ahead."""

    def moved(key: str) -> tuple[float, float]:
        is_away = key.startswith("c2/") and "telemetry" not in key and key != "c2/setpoint"
        by_ms = LATER_MS.get(key, 0.0) + ahead_ms * is_away
        ready_ms, publish_ms = TIMES_MS[key]
        return ready_ms + by_ms, publish_ms + by_ms

    def heard(message: Message) -> int:
        true_ns = message.publish_time_ns - round(ahead_ms * MS) * (message.source in AWAY)
        return true_ns + 25 * MS

    messages = cycle(0, {key: moved(key) for key in TIMES_MS}, plan=plan)
    with RunReader(recorded(folder, messages, plan=plan, heard=heard)) as reader:
        return run_timing(reader)


def hop_ms(found: RunTiming, of: str) -> float:
    (times,) = [row.times for row in found.times if (row.measure, row.of) == ("hop", of)]
    return times.max_us / 1e3


@pytest.mark.parametrize("ahead_ms", [-20.0, 0.0, 0.3, 15.0])
def test_offset_and_hops_are_told_apart_by_the_fastest_messages_each_way(
    ahead_ms: float, tmp_path: Path
) -> None:
    found = timed(tmp_path, ahead_ms)
    (clock,) = found.clocks
    assert (clock.name, clock.agents) == (HOST, AWAY)
    # The setpoint of c2 took 20.3 ms, and the last command 20.2 ms.
    assert clock.ahead_us / 1e3 == pytest.approx(ahead_ms + 0.05)
    assert clock.within_us / 1e3 == pytest.approx(20.25)
    assert hop_ms(found, "command *") == hop_ms(found, "setpoint *") == pytest.approx(20.25)
    assert hop_ms(found, "setpoint") == pytest.approx(0.4)
    assert found.loop_ns.tolist() == [round(93.6 * MS)]
    assert found.slowest[0].loop_ns == round(94.0 * MS)


def test_a_hop_between_hosts_is_judged_by_the_scenario_alone(tmp_path: Path) -> None:
    timed(tmp_path, -20.0)
    found = report_on(tmp_path)
    hops = [verdict for verdict in found.verdicts if verdict.measure == "hop"]
    judged = {verdict.of: verdict.passed for verdict in hops}
    assert judged["setpoint"]
    # The only command that the plant waited for came from the other host.
    assert judged.keys().isdisjoint({"command", "command *"})
    figures = [float(figure) for figure in row(text_of(found), HOST)]
    assert figures == pytest.approx([3, -19.95, 20.25])
