"""Runs in real time verify bit for bit, whatever came late or was lost on the way."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest
from memory_runs import Sent
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
from verifying import first_differences

from agents.faults import Kill
from agents.plan import PlannedOrder, RunPlan
from agents.settings import RestartPolicy
from bus_schemas.bus import Delivery
from bus_schemas.faults import Blackout, Disturbance
from bus_schemas.messages import (
    Command,
    Dispatch,
    Impp,
    Order,
    Residual,
    Setpoint,
    Takeover,
    parse_missing,
)
from bus_schemas.signals import COMMAND, IMPP, ORDER, PRODUCTION, RESIDUAL, SETPOINT
from bus_schemas.tree import OPERATOR, PLANT, ROOT
from launch_scripts.simulation import MemoryRun
from recordings.verify.verification import Verification, verify

LATE = Disturbance(delay_ms=15.0, jitter_ms=15.0, duplicate=0.1, reorder=0.1)


def verified(folder: Path, plan: RunPlan, messages: list[Delivery] | None = None) -> Verification:
    """What the verification of all agents comes to."""
    profile = cloudy_profile(plan)
    found = published(plan, profile) if messages is None else messages
    return verify(record(folder, plan, found, profile))


@pytest.mark.parametrize(
    ("plan", "least_used"),
    [
        (faulty_plan(Disturbance(loss=0.1)), 20),
        (faulty_plan(replace(LATE, loss=0.2), period_cycles=(6, 2), scheme="paper"), 20),
        (faulty_plan(LATE, ratings_kw=THREE_TIERS, period_cycles=(4, 2, 1)), 20),
        (
            faulty_plan(Blackout(signal="dispatch", at=(4, 16)), Blackout(source="c1", at=(8, 20))),
            3,
        ),
        (
            replace(
                faulty_plan(LATE, cycles=30),
                orders=(PlannedOrder(at=3.0, power_kw=90.0, ramp_kw_per_min=2_000.0, hold_s=9.0),),
            ),
            20,
        ),
        # A standby takes over between the turns of its parent.
        (faulty_plan(Kill("c1", 10.5), cycles=30, standby=("c1",), period_cycles=(5, 1)), 0),
    ],
    ids=["loss", "late", "three tiers", "silent for longer than the hold", "ordered", "taken over"],
)
def test_a_run_over_a_bad_network_verifies_equal(
    plan: RunPlan, least_used: int, tmp_path: Path
) -> None:
    messages = published(plan, cloudy_profile(plan))
    missing = [parse_missing(entry) for _, message in messages for entry in message.missing]
    found = verified(tmp_path / "run", plan, messages)
    assert first_differences(found) == {}
    assert found.equal
    decided = [port for port, _ in messages if port.signal.decided]
    assert found.total("compared") == len(decided)
    assert sum(entry.cycle is not None for entry in missing) >= least_used, "older inputs were used"


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
    result = verified(tmp_path / "run", plan, left).agents[user]
    assert result.differences["input not recorded"] >= 1
    assert result.first is not None
    assert result.first.message == entry.key


def test_all_outputs_of_a_stage_lost_by_the_recording_are_named(tmp_path: Path) -> None:
    plan = faulty_plan(Disturbance(loss=0.02))
    lost = {IMPP.of("c1/a"), RESIDUAL.of("c1/a"), COMMAND.of("c1/a")}
    messages = [
        (port, message)
        for port, message in published(plan, cloudy_profile(plan))
        if not (message.cycle == 9 and port in lost)
    ]
    result = verified(tmp_path / "run", plan, messages).agents["c1/a"]
    assert result.first is not None
    assert (result.first.kind, result.first.cycle) == ("not recorded", 10)
    assert result.not_compared > 0, "nobody knows its estimate any more"


def killed(plan: RunPlan, victim: str) -> tuple[list[Delivery], list[int]]:
    """A run in which a node is killed; the places of the messages of its maximum around that."""
    messages = published(plan, cloudy_profile(plan))
    places = [place for place, (port, _) in enumerate(messages) if port is IMPP.of(victim)]
    new = next(at for at, place in enumerate(places) if messages[place][1].incarnation)
    return messages, places[new - 1 : new + 2]


KILLED_CHILD = faulty_plan(Kill("c1/a", 12.2))
TAKEN_OVER = faulty_plan(Kill("c1", 12.2), standby=("c1",))


def test_who_heard_the_other_of_two_processes_of_an_agent_is_not_compared_further(
    tmp_path: Path,
) -> None:
    messages, (_, first, _) = killed(TAKEN_OVER, "c1")
    port, used = messages[first]
    assert isinstance(used, Impp)
    other = replace(used, incarnation=0, sequence=12, power_kw=used.power_kw + 1.0)
    messages.insert(first, (port, other))
    found = verify(record(tmp_path / "run", TAKEN_OVER, messages), "central")
    assert found.equal
    own = [m.cycle for _, m in of_publisher(messages, "central")]
    assert found.agents["central"].not_compared == sum(cycle >= used.cycle for cycle in own)


def test_who_goes_on_with_a_message_of_the_other_of_two_processes_is_not_compared_either(
    tmp_path: Path,
) -> None:
    link = {"source": "central", "listener": "c1", "signal": "setpoint"}
    lost = Blackout(at=(14.0, 15.0), **link)
    plan = faulty_plan(Kill("central", 12.2), lost, standby=("central",))
    messages = published(plan, cloudy_profile(plan))
    place = next(
        place
        for place, (port, message) in enumerate(messages)
        if port == SETPOINT.of("c1") and message.incarnation
    )
    port, used = messages[place]
    assert isinstance(used, Setpoint)
    other = replace(used, incarnation=0, sequence=13, power_kw=used.power_kw - 1.0)
    messages.insert(place, (port, other))
    assert any(f"{port}@{used.cycle}" in m.missing for _, m in of_publisher(messages, "c1"))
    assert verify(record(tmp_path / "run", plan, messages), "c1").agents["c1"].first is None


def test_what_a_killed_process_said_to_others_alone_is_no_difference(tmp_path: Path) -> None:
    messages, (last, *_) = killed(KILLED_CHILD, "c1/a")
    port, said = messages.pop(last)
    used_it = f"{port}@{said.cycle}"
    found = verify(record(tmp_path / "run", KILLED_CHILD, messages), "c1")
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
    found = verify(record(tmp_path / "run", KILLED_CHILD, left), "c1/a")
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
    found = verify(record(tmp_path / "run", plan, messages), listener)
    first = found.agents[listener].first
    joined = next(m.incarnation for p, m in messages if p is port and m.incarnation)
    assert ([] if first is None else [first.cycle - joined]) == cycles_apart


def test_what_the_successor_of_a_successor_says_again_is_no_difference(tmp_path: Path) -> None:
    messages, (_, first, _) = killed(KILLED_CHILD, "c1/a")
    messages.insert(first + 1, messages[first])
    assert verified(tmp_path / "run", KILLED_CHILD, messages).equal


# The recorder was away ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "plan",
    [
        plan_of(cycles=40),
        faulty_plan(LATE, cycles=40),
        faulty_plan(replace(LATE, loss=0.1), cycles=40, period_cycles=(6, 2)),
        faulty_plan(Kill("c1", 20.2), LATE, cycles=40, standby=("c1", "central")),
        faulty_plan(LATE, cycles=40, actuator="limit"),
    ],
    ids=["lockstep", "late", "slow", "standby", "held near a forecast"],
)
def test_what_was_sent_while_the_recorder_was_away_is_no_difference(
    plan: RunPlan, tmp_path: Path
) -> None:
    messages = published(plan, cloudy_profile(plan))
    draw = random.Random(1)
    first, second, third, last = sorted(draw.choices(range(200, len(messages) - 200), k=4))
    kept = [messages[:first], messages[second:third], messages[last:]]
    folder = record(tmp_path / "run", plan, kept[0], cloudy_profile(plan))
    record_on(folder, plan, kept[1], 2)
    record_on(folder, plan, kept[2], 3)
    found = verify(folder)
    assert first_differences(found) == {}
    assert found.equal
    productions = sum(port.signal is PRODUCTION for part in kept for port, _ in part)
    assert found.unrecorded_cycles == plan.timing.cycles - productions
    assert found.agents["c2"].compared > 0.8 * found.agents["c2"].recorded, "it remembers nothing"


def test_the_state_after_a_takeover_that_was_not_recorded_is_unknown(tmp_path: Path) -> None:
    plan = faulty_plan(Kill("central", 12.2), standby=("central",))
    messages = published(plan, cloudy_profile(plan))
    takeover = next(at for at, (_, message) in enumerate(messages) if isinstance(message, Takeover))
    folder = record(tmp_path / "run", plan, messages[:takeover])
    record_on(folder, plan, messages[takeover + 1 :])
    found = verify(folder, "central")
    assert first_differences(found) == {}
    assert found.agents["central"].not_compared > 0


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
    assert verify(folder, "c2").equal


def published_with_orders(plan: RunPlan, given: dict[int, Order]) -> list[Delivery]:
    """All that is published in a run whose plant is given orders after some of its cycles."""
    sent = Sent()
    run = MemoryRun(plan, cloudy_profile(plan), sent)
    for cycle in run.cycles():
        if cycle in given:
            run.loops[PLANT].hear(ORDER.of(ROOT), given[cycle], 0)
    return sent.messages


ORDERED = {
    at: Order(at, 0, OPERATOR, (), power_kw=power_kw, ramp_kw_per_min=1_500.0, hold_s=8.0)
    for at, power_kw in {4: 90.0, 5: 90.0, 9: None, 12: 1e9, 40: -2.0}.items()
}
"""Of those that do not know when the plant takes them: an order, renewed, back, and too much."""


@pytest.mark.parametrize("plan", [plan_of(cycles=60), faulty_plan(LATE, cycles=60)])
def test_orders_given_meanwhile_verify_equal_by_what_the_dispatch_says(
    plan: RunPlan, tmp_path: Path
) -> None:
    messages = published_with_orders(plan, ORDERED)
    dispatches = [message for _, message in messages if isinstance(message, Dispatch)]
    asked_kw = {one.order_power_kw for one in dispatches if one.order_source}
    assert asked_kw == {90.0, None, 1e9, -2.0}
    found = verified(tmp_path / "run", plan, messages)
    assert found.equal
    assert found.total("compared") == sum(port.signal.decided for port, _ in messages)


def test_a_dispatch_that_does_not_follow_from_its_order_is_a_difference(tmp_path: Path) -> None:
    plan = faulty_plan(LATE, cycles=30)
    messages = [
        (port, replace(message, power_kw=message.power_kw + 1.0))
        if isinstance(message, Dispatch) and message.cycle == 14
        else (port, message)
        for port, message in published_with_orders(plan, ORDERED)
    ]
    found = verified(tmp_path / "run", plan, messages)
    assert found.agents[PLANT].differences == {"differs": 1}


@pytest.mark.parametrize(
    "plan", [plan_of(cycles=60), faulty_plan(Disturbance(delay_ms=1.0), cycles=60)]
)
def test_an_order_that_came_while_the_recorder_was_away_makes_no_difference(
    plan: RunPlan, tmp_path: Path
) -> None:
    messages = published_with_orders(plan, ORDERED)
    cycles = [message.cycle for _, message in messages]
    folder = record(tmp_path / "run", plan, messages[: cycles.index(4)], cloudy_profile(plan))
    record_on(folder, plan, messages[cycles.index(14) :])
    found = verify(folder)
    assert first_differences(found) == {}
    assert found.agents[PLANT].compared > 0.5 * found.agents[PLANT].recorded


def test_a_difference_after_the_recorder_was_away_is_found(tmp_path: Path) -> None:
    plan = faulty_plan(LATE)
    messages = published(plan, cloudy_profile(plan))
    third = len(messages) // 3
    folder = record(tmp_path / "run", plan, messages[:third])
    port = SETPOINT.of("c1/a")
    changed = [
        (other, replace(message, power_kw=1.0))
        if other is port and message.cycle == plan.timing.cycles - 2
        else (other, message)
        for other, message in messages[2 * third :]
    ]
    record_on(folder, plan, changed)
    found = verify(folder)
    assert found.agents["c1"].differences == {"differs": 1}
    assert not found.equal


@pytest.mark.parametrize(
    ("dead", "periods", "share"),
    [(None, (6, 2), 0.3), ("c2", (1, 1), 0.55), ("c2", (6, 2), 0.8), ("c1/a", (1, 1), 0.3)],
)
def test_a_run_that_broke_off_is_compared_up_to_there_also_without_a_dead_agent(
    dead: str | None, periods: tuple[int, int], share: float, tmp_path: Path
) -> None:
    kills, never = (Kill(dead, 0.01),) if dead else (), RestartPolicy(when="never")
    plan, sent = faulty_plan(*kills, LATE, period_cycles=periods, restart=never), Sent()
    run = MemoryRun(plan, cloudy_profile(plan), sent)
    assert len(list(run.cycles())) == plan.timing.cycles
    cut = sent.messages[: round(len(sent.messages) * share)]
    found = verified(tmp_path / "run", plan, cut)
    assert first_differences(found) == {}
    assert found.stop_cycle is None
    assert found.total("compared") > 0.8 * len(cut)
    assert found.equal


# External agents ----------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["paper", "predictive"])
def test_of_external_agents_direct_controllers_are_re_run_others_if_asked_for(
    tmp_path: Path, scheme: str
) -> None:
    plan = faulty_plan(LATE, external=("c1/a", "c2", "plant"), scheme=scheme)
    found = verified(tmp_path / "run", plan)
    assert found.equal
    assert found.left_out.keys() == {"c2", "plant"}
    assert not found.left_out.keys() & found.agents.keys()
    asked = verify(tmp_path / "run", ("c2",))
    assert asked.equal
    assert asked.agents.keys() == {"c2"}


@pytest.mark.parametrize(
    ("scheme", "wrong"), [("paper", {"impp", "residual"}), ("predictive", {"residual"})]
)
def test_a_device_may_have_an_estimate_of_its_own_but_by_the_paper(
    tmp_path: Path, scheme: str, wrong: set[str]
) -> None:
    plan = faulty_plan(LATE, external=("c1/a",), scheme=scheme)
    estimates = published(plan, cloudy_profile(plan))
    for number, (port, message) in enumerate(estimates):
        if port.node == "c1/a" and isinstance(message, Impp | Residual) and message.cycle == 7:
            more_kw = 1.0 if isinstance(message, Impp) else 2.0
            estimates[number] = port, replace(message, power_kw=message.power_kw + more_kw)
    found = verified(tmp_path / "run", plan, estimates)
    result = found.agents["c1/a"]
    assert result.differences["differs"] >= len(wrong)
    assert result.first is not None
    assert result.first.message == f"c1/a/{min(wrong)}"


def test_a_device_chooses_how_far_above_its_forecast_it_holds_its_inverter(tmp_path: Path) -> None:
    # So long that it has learned how far the maximum changes, and is not at its rating.
    long: dict[str, Any] = {"scheme": "predictive", "actuator": "limit", "cycles": 60}
    plan = faulty_plan(Disturbance(loss=0.02), external=("c1/a",), **long)
    messages = published(plan, cloudy_profile(plan))
    rating_kw, held = dict(plan.inverters)["c1/a"], 0
    for number, (port, message) in enumerate(messages):
        if (
            port == COMMAND.of("c1/a")
            and isinstance(message, Command)
            and message.alpha == 1.0
            and message.power_kw < rating_kw
        ):
            messages[number] = port, replace(message, power_kw=rating_kw)
            held += 1
    assert held
    assert "c1/a" not in first_differences(verified(tmp_path / "run", plan, messages))
    ours = verified(tmp_path / "ours", faulty_plan(LATE, **long), messages)
    assert "c1/a" in first_differences(ours), "our own controllers have no such choice"


def test_of_two_messages_in_one_cycle_the_first_one_was_used_and_none_of_no_cycle(
    tmp_path: Path,
) -> None:
    plan = faulty_plan(Disturbance(loss=0.02), external=("c1/a",))
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
    assert found.agents.pop("c1/a").differences == {"sent twice": 1}
    assert found.equal
    assert found.messages.misplaced == 0
