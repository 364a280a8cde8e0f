"""Runs in real time verify bit for bit, whatever came late or was lost on the way."""

from __future__ import annotations

from math import nan
from pathlib import Path

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
from agents.plan import RunPlan
from agents.plan_parts import PlannedOrder
from agents.settings import RestartPolicy, StorageSettings
from bus_schemas.bus import Delivery
from bus_schemas.faults import Blackout, Disturbance
from bus_schemas.messages import (
    Dispatch,
    Impp,
    Order,
    Residual,
    parse_missing,
)
from bus_schemas.signals import IMPP, ORDER, RESIDUAL
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
    ],
    ids=["loss", "late", "three tiers", "silent for longer than the hold", "ordered"],
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


KILLED_CHILD = faulty_plan(Kill("c1/a", 12.2))


def killed(plan: RunPlan) -> tuple[list[Delivery], list[int]]:
    """A run in which c1/a is killed; the places of its IMPPs around that."""
    messages = published(plan, cloudy_profile(plan))
    places = [place for place, (port, _) in enumerate(messages) if port is IMPP.of("c1/a")]
    new = next(at for at, place in enumerate(places) if messages[place][1].incarnation)
    return messages, places[new - 1 : new + 2]


def test_rerun_stops_at_an_ambiguous_input(tmp_path: Path) -> None:
    plan = faulty_plan(LATE)
    messages = published(plan, cloudy_profile(plan))
    place = next(
        place
        for place, (port, message) in enumerate(messages)
        if port is IMPP.of("c1") and message.cycle == 12
    )
    port, used = messages[place]
    assert isinstance(used, Impp)
    messages.insert(place, (port, replace(used, power_kw=used.power_kw + 1.0)))
    found = verify(record(tmp_path / "run", plan, messages), "central")
    result = found.agents["central"]
    assert (result.first, found.equal) == (None, False)
    (gap,) = result.gaps
    assert gap.since in (12, 13), "it may have come late"
    assert gap.until is None
    own = [message for _, message in of_publisher(messages, "central")]
    assert 0 < found.asked - result.compared <= sum(message.cycle >= 12 for message in own)


def test_a_run_whose_storage_was_restarted_is_repeated_bit_for_bit(tmp_path: Path) -> None:
    battery = StorageSettings(name="battery", cluster="c2", rating_kw=60.0, capacity_kwh=1.0)
    plan = faulty_plan(Kill("c2/battery", 12.2), storages=(battery,), cycles=40)
    profile = cloudy_profile(plan)
    messages = published(plan, profile)
    restarted = [one for port, one in messages if port is IMPP.of("c2/battery") if one.incarnation]
    assert restarted
    found = verify(record(tmp_path / "run", plan, messages, profile))
    assert found.equal, found.first


def test_unrecorded_messages_of_a_killed_process_are_no_difference(
    tmp_path: Path,
) -> None:
    messages, (last, *_) = killed(KILLED_CHILD)
    port, sent = messages.pop(last)
    used_it = f"{port}@{sent.cycle}"
    found = verify(record(tmp_path / "run", KILLED_CHILD, messages), "c1")
    assert not found.differs
    assert not found.equal
    own = [message for _, message in of_publisher(messages, "c1")]
    based_on_it = [m for m in own if m.cycle == sent.cycle or used_it in m.missing]
    assert found.asked - found.total("compared") == len(based_on_it), (
        "a supervisor remembers nothing"
    )


# The recorder was away ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "plan",
    [
        plan_of(cycles=40),
        faulty_plan(LATE, cycles=40),
        faulty_plan(replace(LATE, loss=0.1), cycles=40, period_cycles=(6, 2)),
    ],
    ids=["lockstep", "late", "slow"],
)
def test_agents_are_compared_up_to_the_first_gap_of_the_recorder_and_no_further(
    plan: RunPlan, tmp_path: Path
) -> None:
    messages = published(plan, cloudy_profile(plan))
    cycles = [message.cycle for _, message in messages]
    left, back = cycles.index(14), cycles.index(20)
    folder = record(tmp_path / "run", plan, messages[:left], cloudy_profile(plan))
    record_on(folder, plan, messages[back:])
    found = verify(folder)
    assert first_differences(found) == {}
    assert not found.equal
    assert 0.2 < found.share < 0.6
    for name in ("central", "c1/a", "plant"):
        (gap,) = found.agents[name].gaps
        assert gap.until is None
        assert 13 <= gap.since <= 24, name
    assert found.agents["c2"].compared > 0.5 * found.agents["c2"].recorded, "it remembers nothing"


def test_an_agent_that_starts_anew_after_a_gap_is_compared_again(tmp_path: Path) -> None:
    plan = faulty_plan(Kill("c1/a", 24.2), cycles=40)
    messages = published(plan, cloudy_profile(plan))
    cycles = [message.cycle for _, message in messages]
    folder = record(tmp_path / "run", plan, messages[: cycles.index(14)])
    record_on(folder, plan, messages[cycles.index(20) :])
    joined = next(m.incarnation for _, m in of_publisher(messages, "c1/a") if m.incarnation)
    result = verify(folder, "c1/a").agents["c1/a"]
    (gap,) = result.gaps
    assert (result.first, gap.until) == (None, joined)
    later = sum(m.cycle >= joined for _, m in of_publisher(messages, "c1/a"))
    assert result.compared >= later > 15
    changed = [
        (port, replace(message, power_kw=1.0))
        if port is IMPP.of("c1/a") and message.cycle == 38
        else (port, message)
        for port, message in messages[cycles.index(20) :]
    ]
    (folder / "run-2.mcap").unlink()
    record_on(folder, plan, changed)
    first = verify(folder, "c1/a").agents["c1/a"].first
    assert first is not None
    assert (first.cycle, first.message) == (38, "c1/a/impp")


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
    assert not found.differs
    assert not found.equal, "not all was compared"
    assert found.total("compared") == found.total("recorded") < found.asked
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


@pytest.mark.parametrize("scheme", ["paper", "predictive"])
def test_a_number_that_no_listener_accepts_is_named_before_what_follows_from_it(
    scheme: str, tmp_path: Path
) -> None:
    plan = faulty_plan(Disturbance(loss=0.02), external=("c1/a",), scheme=scheme)
    messages = [
        (port, replace(message, power_kw=nan))
        if port.node == "c1/a" and isinstance(message, Impp | Residual) and message.cycle == 7
        else (port, message)
        for port, message in published(plan, cloudy_profile(plan))
    ]
    agent, first = verified(tmp_path / "run", plan, messages).first or ("", None)
    assert first is not None
    assert (agent, first.message, first.kind, first.cycle) == ("c1/a", "c1/a/impp", "refused", 7)
    assert "power_kw" in first.text


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


@pytest.mark.parametrize(("cycles_before", "kinds"), [(0, {}), (3, {"only new": 1})])
def test_only_the_last_messages_of_a_killed_process_may_be_missing(
    cycles_before: int, kinds: dict[str, int], tmp_path: Path
) -> None:
    messages, (last, *_) = killed(KILLED_CHILD)
    port, cycle = RESIDUAL.of("c1/a"), messages[last][1].cycle - cycles_before
    left = [pair for pair in messages if pair[0] is not port or pair[1].cycle != cycle]
    found = verify(record(tmp_path / "run", KILLED_CHILD, left), "c1/a")
    assert found.agents["c1/a"].differences == kinds
