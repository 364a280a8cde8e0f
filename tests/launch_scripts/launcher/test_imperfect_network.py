"""Runs over an imperfect network, in memory on a virtual clock."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from memory_runs import Sent, timeless
from sent_messages import run_with
from typer.testing import CliRunner

from bus_schemas.codec import encode
from bus_schemas.faults import FaultRule
from bus_schemas.missing import parse_missing
from bus_schemas.signals import (
    COMMAND,
    HELP,
    IMPP,
    PRODUCTION,
    SETPOINT,
    TELEMETRY,
)
from bus_schemas.tree import ROOT
from launch_scripts.cli import app
from launch_scripts.launcher.simulation import MemoryRun
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario

CYCLES = 20
MS = 1_000_000
SECOND_NS = 1_000 * MS


@pytest.fixture(scope="module")
def valley() -> Preparation:
    """60 inverters in four tiers."""
    return prepare(load_scenario("valley"), RunOptions(duration=str(CYCLES)), "faults")


def decisions(sent: Sent) -> list[tuple[str, bytes]]:
    """What agents decided, in the order of cycle and key, without times."""
    found = [
        (message.cycle, str(port), encode(timeless(message)))
        for port, message in sent.messages
        if port.signal.decided
    ]
    return [(key, data) for _, key, data in sorted(found)]


def total(run: MemoryRun, name: str) -> int:
    return sum(getattr(loop, name) for loop in run.loops.values())


# What changes nothing -----------------------------------------------------------------------------


@pytest.mark.parametrize(("scheme", "periods"), [("paper", (1, 1, 1)), ("predictive", (6, 2, 1))])
def test_delays_within_the_cycle_change_nothing_but_the_time(
    valley: Preparation, scheme: str, periods: tuple[int, ...]
) -> None:
    changes: dict[str, Any] = {"scheme": scheme, "period_cycles": periods}
    # A place of the cycle has 0.9 s / 8 = 112 ms.
    run, sent = run_with(valley, [FaultRule(delay_ms=80.0)], **changes)
    assert (total(run, "missing_inputs"), total(run, "old_inputs")) == (0, 0)
    assert decisions(sent) == decisions(run_with(valley, (), **changes)[1])
    leaf, hops_before = valley.plan.tree.leaves[0], 2 * valley.plan.tree.height + 1
    assert sent.of(COMMAND.of(leaf))[6].publish_time_ns == 6 * SECOND_NS + hops_before * 80 * MS


def test_help_that_is_lost_keeps_nobody_waiting(valley: Preparation) -> None:
    words = RunOptions(duration=str(CYCLES), faults=["signal=help,loss=100%"])
    prepared = prepare(load_scenario("valley"), words, "faults")
    run, sent = run_with(prepared, prepared.plan.faults)
    assert any(port.signal is HELP for port, _ in sent.messages)
    assert (total(run, "missing_inputs"), run.bus.tally.as_counts()) == (0, {})
    assert decisions(sent) == decisions(run_with(valley, ())[1])
    for _, message in sent.messages:
        last = message.cycle - (message.cycle == CYCLES)  # The stop comes after the last cycle.
        assert message.publish_time_ns == last * SECOND_NS, "it went out at once"


# What is lost and late ----------------------------------------------------------------------------


@settings(max_examples=5, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32),
    delay_ms=st.floats(0.0, 3000.0),
    jitter_ms=st.floats(0.0, 500.0),
    loss=st.floats(0.0, 0.5),
    duplicate=st.floats(0.0, 0.5),
)
def test_a_run_over_a_bad_network_repeats_to_the_last_bit(
    valley: Preparation, seed: int, **words: float
) -> None:
    rule = FaultRule(**words)  # type: ignore[arg-type]
    (one, sent), (other, again) = (
        run_with(valley, [rule], faults_seed=seed, cycles=6) for _ in range(2)
    )
    assert [*map(str, sent.messages)] == [*map(str, again.messages)]
    assert one.bus.tally == other.bus.tally


@pytest.mark.parametrize("pace", [1, 10])
def test_the_plant_ticks_on_the_clock_whatever_the_network_does(
    valley: Preparation, pace: int
) -> None:
    rule = FaultRule(loss=0.3, delay_ms=400.0, jitter_ms=300.0)
    _, sent = run_with(valley, [rule], cycle_wall_ns=SECOND_NS // pace)
    leaf = valley.plan.tree.leaves[0]
    ticks = [message.publish_time_ns for message in sent.of(TELEMETRY.of(leaf)).values()]
    assert ticks == [cycle * SECOND_NS // pace for cycle in range(CYCLES)]
    assert len(sent.of(PRODUCTION.of(ROOT))) == CYCLES


# Controllers that are slow, or never answer -------------------------------------------------------


@pytest.mark.parametrize("silent", ["central", "z1/c1"])
@pytest.mark.parametrize(
    ("periods", "deadlines_ms"), [((1, 1, 1), ()), ((60, 10, 1), (500, 600, 700, 800))]
)
def test_everybody_goes_on_without_a_controller_that_never_answers(
    valley: Preparation, silent: str, periods: tuple[int, ...], deadlines_ms: tuple[int, ...]
) -> None:
    changes: dict[str, Any] = {
        "period_cycles": periods,
        "tier_deadlines_ns": tuple(deadline * MS for deadline in deadlines_ms),
    }
    run, sent = run_with(valley, [FaultRule(source=silent, loss=1.0)], **changes)
    tree = valley.plan.tree
    assert Counter(port.signal.name for port, _ in sent.messages)["command"] == 60 * CYCLES
    for leaf in tree.leaves:
        deadline_ns = run.plan.deadlines.deadline_ns(leaf, "actuate")
        for cycle, command in sent.of(COMMAND.of(leaf)).items():
            assert command.publish_time_ns <= cycle * SECOND_NS + deadline_ns
    for node in tree.parents:
        assert list(sent.of(IMPP.of(node))) == list(range(CYCLES))


def test_tiers_that_act_rarely_use_what_comes_after_a_deadline_from_their_next_turn_on() -> None:
    prepared = prepare(load_scenario("valley"), RunOptions(duration="75"), "slow")
    slow = FaultRule(source="central", delay_ms=2_500.0)
    _, sent = run_with(prepared, [slow], period_cycles=(60, 10, 1))
    upper = prepared.plan.tree.children(ROOT)[0]
    lower = prepared.plan.tree.children(upper)[0]
    targets = sent.of(SETPOINT.of(lower))
    # Sent in cycle 60 and heard in cycle 62; until then that of cycle 0 was the newest.
    assert targets[60].missing == (f"{upper}/setpoint@0",)
    assert targets[70].missing == ()


# What the schemes may give ------------------------------------------------------------------------


BAD = FaultRule(delay_ms=250.0, jitter_ms=200.0, loss=0.05)


@pytest.fixture(scope="module")
def clouds() -> Preparation:
    """Of `oahu` some minutes with clouds."""
    return prepare(load_scenario("oahu"), RunOptions(duration="120"), "schemes")


def given_beyond_impp_kw(prepared: Preparation, scheme: str) -> float:
    """The most that a parent gives its children in all beyond what it knows that they have.

    A silent child gives its own request, whatever it has: no parent can change that.
    """
    run, sent = run_with(prepared, [BAD], scheme=scheme, correction=False)
    most_kw = 0.0
    for node in run.plan.tree.parents:
        children = run.plan.tree.children(node)
        reports = {child: sent.of(IMPP.of(child)) for child in children}
        setpoints = [sent.of(SETPOINT.of(child)) for child in children]
        for cycle, first in setpoints[0].items():
            given_kw = sum(found[cycle].power_kw for found in setpoints)
            used = {entry.key: entry.cycle for entry in map(parse_missing, first.missing)}
            known_kw = 0.0
            for child, setpoint in zip(children, setpoints, strict=True):
                from_cycle = used.get(str(IMPP.of(child)), cycle)
                known = setpoint[cycle] if from_cycle is None else reports[child][from_cycle]
                known_kw += known.power_kw
            most_kw = max(most_kw, given_kw - known_kw)
    return most_kw


def test_with_old_reports_the_papers_rule_gives_no_more_than_there_is_and_predictive_does(
    clouds: Preparation,
) -> None:
    assert given_beyond_impp_kw(clouds, "paper") < 1e-6
    assert given_beyond_impp_kw(clouds, "predictive") > 1.0


def test_a_silence_is_in_simulated_time_at_any_pace_and_a_rule_without_messages_is_named(
    tmp_path: Path,
) -> None:
    words = ["simulate", "oahu", "--duration", "5", "--pace", "5"]
    words += ["--json", str(tmp_path / "s.json")]
    faults = ["--fault", "signal=impp,silent=2s..4s", "--fault", "silent=50s..60s"]
    result = CliRunner().invoke(app, [*words, *faults, "--out", str(tmp_path / "run")])
    assert result.exit_code == 0, result.output
    summary = json.loads((tmp_path / "s.json").read_text())
    assert summary["faults"] == {"lost": 2 * (17 + 3)}
    assert "acted on 40 messages in cycles 2 to 3" in " ".join(result.output.split())
    assert "never acted" in " ".join(result.output.split())
