"""Runs in real time verify bit for bit, whatever came late or was lost on the way."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from msgspec.structs import replace
from recorded_runs import (
    THREE_TIERS,
    cloudy_profile,
    faulty_plan,
    of_publisher,
    plan_of,
    published,
    record,
    record_on,
)
from verifying import findings

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.faults import FaultRule
from bus_schemas.messages import Impp, Takeover
from bus_schemas.missing import parse_missing
from bus_schemas.signals import COMMAND, IMPP, PRODUCTION, RESIDUAL, SETPOINT
from recordings.verify.comparison import Comparison
from recordings.verify.verification import Verification, verify

LATE = FaultRule(delay_ms=15.0, jitter_ms=15.0, duplicate=0.1, reorder=0.1)


def verified(
    folder: Path, plan: RunPlan, messages: list[Delivery] | None = None, seed: int = 1
) -> Verification:
    """What the verification of all agents comes to."""
    profile = cloudy_profile(plan, seed)
    found = published(plan, profile) if messages is None else messages
    return verify(record(folder, plan, found, profile), (), Comparison())


@pytest.mark.parametrize(
    "plan",
    [
        faulty_plan(FaultRule(loss=0.1)),
        faulty_plan(replace(LATE, loss=0.2), period_cycles=(6, 2), scheme="paper"),
        faulty_plan(LATE, ratings_kw=THREE_TIERS, period_cycles=(4, 2, 1)),
    ],
    ids=["loss", "late", "three tiers"],
)
def test_a_run_over_a_bad_network_verifies_equal(plan: RunPlan, tmp_path: Path) -> None:
    messages = published(plan, cloudy_profile(plan))
    missing = [parse_missing(entry) for _, message in messages for entry in message.missing]
    found = verified(tmp_path / "run", plan, messages)
    assert findings(found) == {}
    assert found.equal
    assert found.total("compared") == len(messages) - 2, "all but the plant's start and stop"
    assert sum(entry.cycle is not None for entry in missing) > 20, "older inputs were used"


def test_inputs_that_are_silent_for_long_are_done_without(tmp_path: Path) -> None:
    plan = faulty_plan(
        FaultRule(signal="dispatch", silent=((4.0, 16.0),)),
        FaultRule(source="c1", silent=((8.0, 20.0),)),
    )
    messages = published(plan, cloudy_profile(plan))
    silent = {parse_missing(entry).cycle for _, message in messages for entry in message.missing}
    assert None in silent, "some inputs are older than the hold"
    commands = sum(port.signal is COMMAND for port, _ in messages)
    assert commands < plan.cycles * len(plan.inverters), "some inverters decided for themselves"
    assert verified(tmp_path / "run", plan, messages).equal


def test_an_older_input_that_the_recording_lost_is_named(tmp_path: Path) -> None:
    plan = faulty_plan(LATE)
    messages = published(plan, cloudy_profile(plan))
    entry, user = next(
        (parse_missing(entry), message.source)
        for _, message in messages
        for entry in message.missing
        if "impp@" in entry
    )
    left = [pair for pair in messages if (str(pair[0]), pair[1].cycle) != entry]
    assert len(left) == len(messages) - 1
    findings = verified(tmp_path / "run", plan, left).agents[user]
    assert findings.differences["input not recorded"] >= 1
    assert findings.first is not None
    assert findings.first.message == entry.key


def test_all_outputs_of_a_stage_lost_by_the_recording_are_named(tmp_path: Path) -> None:
    plan = faulty_plan(FaultRule(loss=0.02))
    lost = {IMPP.of("c1/a"), RESIDUAL.of("c1/a"), COMMAND.of("c1/a")}
    messages = [
        (port, message)
        for port, message in published(plan, cloudy_profile(plan))
        if not (message.cycle == 9 and port in lost)
    ]
    findings = verified(tmp_path / "run", plan, messages).agents["c1/a"]
    assert findings.first is not None
    assert (findings.first.kind, findings.first.cycle) == ("not recorded", 10)
    assert findings.not_compared_from == 10, "nobody knows its estimate any more"


def test_a_standby_that_took_over_between_its_parent_s_turns_is_compared(tmp_path: Path) -> None:
    plan = faulty_plan(
        FaultRule(kill="c1", at=(10.5,)), cycles=30, standby=("c1",), period_cycles=(5, 1)
    )
    messages = published(plan, cloudy_profile(plan, 0))
    assert [message.cycle for _, message in messages if isinstance(message, Takeover)] == [11]
    assert verified(tmp_path / "run", plan, messages, seed=0).equal


def killed(plan: RunPlan, victim: str) -> tuple[list[Delivery], list[int]]:
    """A run in which a node is killed; the places of the messages of its maximum around that."""
    messages = published(plan, cloudy_profile(plan))
    places = [place for place, (port, _) in enumerate(messages) if port is IMPP.of(victim)]
    new = next(at for at, place in enumerate(places) if messages[place][1].incarnation)
    return messages, places[new - 1 : new + 2]


KILLED_CHILD = faulty_plan(FaultRule(kill="c1/a", at=(12.2,)))
TAKEN_OVER = faulty_plan(FaultRule(kill="c1", at=(12.2,)), standby=("c1",))


def test_who_heard_the_other_of_two_processes_of_an_agent_is_not_compared_further(
    tmp_path: Path,
) -> None:
    messages, (_, first, _) = killed(TAKEN_OVER, "c1")
    port, used = messages[first]
    assert isinstance(used, Impp)
    other = replace(used, incarnation=0, sequence=12, power_kw=used.power_kw + 1.0)
    messages.insert(first, (port, other))
    found = verify(record(tmp_path / "run", TAKEN_OVER, messages), "central", Comparison())
    assert found.equal
    assert found.agents["central"].not_compared_from == used.cycle


def test_what_a_killed_process_said_to_others_alone_is_no_difference(tmp_path: Path) -> None:
    messages, (last, *_) = killed(KILLED_CHILD, "c1/a")
    port, said = messages.pop(last)
    used_it = f"{port}@{said.cycle}"
    found = verify(record(tmp_path / "run", KILLED_CHILD, messages), "c1", Comparison())
    assert found.equal
    own = [message for _, message in of_publisher(messages, "c1")]
    based_on_it = [m for m in own if m.cycle == said.cycle or used_it in m.missing]
    assert found.total("not_compared") == len(based_on_it)


@pytest.mark.parametrize(("cycles_before", "kinds"), [(0, {}), (3, {"only new": 1})])
def test_what_a_process_did_not_send_as_it_was_killed_is_no_difference(
    cycles_before: int, kinds: dict[str, int], tmp_path: Path
) -> None:
    messages, (last, *_) = killed(KILLED_CHILD, "c1/a")
    port, cycle = RESIDUAL.of("c1/a"), messages[last][1].cycle - cycles_before
    left = [pair for pair in messages if pair[0] is not port or pair[1].cycle != cycle]
    found = verify(record(tmp_path / "run", KILLED_CHILD, left), "c1/a", Comparison())
    assert found.agents["c1/a"].differences == kinds


@pytest.mark.parametrize(
    ("plan", "victim", "listener", "at", "cycles_apart"),
    [
        (TAKEN_OVER, "c1", "central", 1, []),
        (TAKEN_OVER, "c1", "central", 2, [1]),
        (KILLED_CHILD, "c1/a", "c1", 1, [0]),
    ],
)
def test_in_the_cycle_of_a_takeover_alone_the_recording_may_mislead(
    plan: RunPlan,
    victim: str,
    listener: str,
    at: int,
    cycles_apart: list[int],
    tmp_path: Path,
) -> None:
    messages, places = killed(plan, victim)
    port, said = messages[places[at]]
    assert isinstance(said, Impp)
    messages[places[at]] = port, replace(said, power_kw=said.power_kw + 1.0)
    found = verify(record(tmp_path / "run", plan, messages), listener, Comparison())
    first = found.agents[listener].first
    joined = next(m.incarnation for p, m in messages if p is port and m.incarnation)
    assert ([] if first is None else [first.cycle - joined]) == cycles_apart


def test_what_the_successor_of_a_successor_says_again_is_no_difference(tmp_path: Path) -> None:
    messages, (_, first, _) = killed(KILLED_CHILD, "c1/a")
    messages.insert(first + 1, messages[first])
    assert verified(tmp_path / "run", KILLED_CHILD, messages).equal


# The recorder was away ----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "plan",
    [
        plan_of(cycles=40),
        faulty_plan(LATE, cycles=40),
        faulty_plan(replace(LATE, loss=0.1), cycles=40, period_cycles=(6, 2)),
        faulty_plan(FaultRule(kill="c1", at=(20.2,)), LATE, cycles=40, standby=("c1", "central")),
    ],
    ids=["lockstep", "late", "slow", "standby"],
)
def test_what_was_sent_while_the_recorder_was_away_is_no_difference(
    plan: RunPlan, seed: int, tmp_path: Path
) -> None:
    messages = published(plan, cloudy_profile(plan, seed))
    draw = random.Random(seed)
    first, second, third, last = sorted(draw.choices(range(200, len(messages) - 200), k=4))
    kept = [messages[:first], messages[second:third], messages[last:]]
    folder = record(tmp_path / "run", plan, kept[0], cloudy_profile(plan, seed))
    record_on(folder, plan, kept[1], 2)
    record_on(folder, plan, kept[2], 3)
    found = verify(folder, (), Comparison())
    assert findings(found) == {}
    assert found.equal
    productions = sum(port.signal is PRODUCTION for part in kept for port, _ in part)
    assert found.unrecorded_cycles == plan.cycles - productions
    assert found.agents["c2"].compared > 0.8 * found.agents["c2"].recorded, "it remembers nothing"


def test_a_recorder_that_was_away_in_one_stage_of_a_cycle_makes_no_difference(
    tmp_path: Path,
) -> None:
    plan = faulty_plan(LATE)
    messages = published(plan, cloudy_profile(plan))
    back = next(  # What a supervisor decides on an input that came after its first stage.
        place
        for place, (port, message) in enumerate(messages)
        if port is SETPOINT.of("c2/c") and message.cycle > 9 and "impp@" in str(message.missing)
    )
    cycle = messages[back][1].cycle
    left = [(port, message.cycle) for port, message in messages].index((IMPP.of("c2"), cycle))
    folder = record(tmp_path / "run", plan, messages[:left])
    record_on(folder, plan, messages[back:])
    assert verify(folder, "c2", Comparison()).equal


def test_a_difference_after_the_recorder_was_away_is_found(tmp_path: Path) -> None:
    plan = faulty_plan(LATE)
    messages = published(plan, cloudy_profile(plan))
    third = len(messages) // 3
    folder = record(tmp_path / "run", plan, messages[:third])
    port = SETPOINT.of("c1/a")
    changed = [
        (other, replace(message, power_kw=1.0))
        if other is port and message.cycle == plan.cycles - 2
        else (other, message)
        for other, message in messages[2 * third :]
    ]
    record_on(folder, plan, changed)
    found = verify(folder, (), Comparison())
    assert found.agents["c1"].differences == {"differs": 1}
    assert not found.equal


@pytest.mark.parametrize("share", [0.3, 0.55, 0.8])
def test_a_run_that_broke_off_is_equal_up_to_there(share: float, tmp_path: Path) -> None:
    for number, plan in enumerate([faulty_plan(LATE), faulty_plan(LATE, period_cycles=(6, 2))]):
        messages = published(plan, cloudy_profile(plan))
        cut = messages[: round(len(messages) * share)]
        found = verified(tmp_path / f"run{number}", plan, cut)
        assert findings(found) == {}
        assert found.stop_cycle is None
        assert found.total("compared") + found.cut_off + found.not_decided == len(cut)
        assert found.total("compared") > 0.7 * len(cut)
        assert found.equal


# External agents ----------------------------------------------------------------------------------


def test_an_external_agent_is_re_run_only_if_it_is_asked_for(tmp_path: Path) -> None:
    plan = faulty_plan(LATE, external=("c1/a", "plant"))
    found = verified(tmp_path / "run", plan)
    assert found.equal
    assert found.left_out.keys() == {"c1/a", "plant"}
    assert not found.left_out.keys() & found.agents.keys()
    asked = verify(tmp_path / "run", ("c1/a",), Comparison())
    assert asked.equal
    assert asked.agents.keys() == {"c1/a"}


def test_of_two_messages_in_one_cycle_the_first_one_was_used_and_none_of_no_cycle(
    tmp_path: Path,
) -> None:
    plan = faulty_plan(FaultRule(loss=0.02), external=("c1/a",))
    messages = published(plan, cloudy_profile(plan))
    place = next(
        place
        for place, (port, message) in enumerate(messages)
        if port is IMPP.of("c1/a") and message.cycle == 7
    )
    port, message = messages[place]
    odd = [replace(message, power_kw=12.5), replace(message, cycle=4711)]
    messages[place + 1 : place + 1] = [(port, other) for other in odd]
    found = verified(tmp_path / "run", plan, messages)
    assert found.equal
    assert found.misplaced == 0
