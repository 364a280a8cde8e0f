"""The desk in a run's folder: who may give orders, and that each order gets one true reply."""

from __future__ import annotations

import random
import stat
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from order_desks import SCHEDULED_KW, Giver, PlantByHand, obeying_plant, plant_by_hand
from plans_by_hand import plan_of

from agents.plan_parts import PlannedOrder
from bus_schemas.messages import Order
from bus_schemas.tree import OPERATOR
from sim_plant.order_desk import (
    SOCKET_NAME,
    OrderLine,
    PlantStatus,
    Reply,
)

HEAD = b'{"cycle": 0, "sim_time_ns": 0, "missing": [], '


def operators_order(cycle: int, power_kw: float) -> Order:
    stamp = time.monotonic_ns()
    return Order(cycle, 0, OPERATOR, (), publish_time_ns=stamp, power_kw=power_kw)


def test_its_socket_is_for_the_owner_alone_and_goes_with_the_run(tmp_path: Path) -> None:
    folder = tmp_path / ("long" * 40)  # Longer than the path of a socket may be.
    folder.mkdir()
    plan = plan_of({"a": 200.0}, cycles=1_000)
    with obeying_plant(folder, plan):
        found = (folder / SOCKET_NAME).stat().st_mode
        assert stat.S_ISSOCK(found)
        assert stat.S_IMODE(found) == 0o600
        with OrderLine(folder) as line:
            line.give("command", power_kw=50.0)
            assert any(isinstance(one, Reply) and one.is_in_force for one in line.heard())
            status = next(one for one in line.heard() if isinstance(one, PlantStatus))
            assert status.dispatch.power_kw == 50.0
    assert not (folder / SOCKET_NAME).exists()


@pytest.mark.parametrize(
    ("packet", "said"),
    [
        (b'{"power_kw": 0.0}', "cycle"),
        (HEAD + b'"source": "scenario", "power_kw": 0.0}', "source"),
        (HEAD + b'"source": "command", "power_kw": NaN}', "JSON"),
        (HEAD + b'"source": "command", "power_kw": -1}', "power_kw: expected 0 to 200, got -1"),
        (HEAD + b'"source": "command", "power_kw": 201}', "power_kw: expected 0 to 200, got 201"),
        (
            HEAD + b'"source": "command", "power_kw": 0.0, "ramp_kw_per_min": 0}',
            "ramp_kw_per_min: expected above 0 to 1e+30, got 0",
        ),
        (
            HEAD + b'"source": "command", "power_kw": 0.0, "hold_s": 0}',
            "hold_s: expected above 0 to 1e+30, got 0",
        ),
        (HEAD + b'"source": "\xff", "power_kw": 0.0}', "utf-8"),
        (HEAD + b'"source": "a\\u001b[31m", "power_kw": 0.0}', "source"),
        (HEAD + b'"source": "command", "other": ' + b"[" * 4_000, "other"),
        (b"[" * 8_000, "JSON"),
        (b"\xff" * 9_000, "JSON"),
        (b"", "truncated"),
    ],
)
def test_a_wrong_order_is_refused_at_once_by_name_and_the_next_one_obeyed(
    tmp_path: Path, packet: bytes, said: str
) -> None:
    with plant_by_hand(tmp_path) as plant, Giver(tmp_path) as wrong, Giver(tmp_path) as right:
        wrong.raw.send(packet)
        text = wrong.reply().text
        assert text.startswith("refused: ")
        assert said in text or said == "JSON"
        assert text.isprintable()
        assert not plant.go_on().order_source
        right.give("page", 50.0)
        right.arrive()
        assert plant.go_on().power_kw == 50.0


@given(packet=st.binary(max_size=300) | st.text(max_size=60).map(str.encode))
@settings(
    max_examples=1_000,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_any_bytes_are_refused_and_the_plant_goes_on(
    desk_of_all_examples: tuple[Path, PlantByHand], packet: bytes
) -> None:
    folder, plant = desk_of_all_examples
    with Giver(folder) as giver:
        giver.raw.send(packet)
        assert giver.reply().text.startswith("refused: ")
    plant.go_on()


@pytest.fixture
def desk_of_all_examples(tmp_path: Path) -> Iterator[tuple[Path, PlantByHand]]:
    with plant_by_hand(tmp_path) as plant:
        yield tmp_path, plant


SOURCES = ("command", "page", "modbus", OPERATOR)


def test_of_two_orders_in_one_cycle_the_newer_counts_and_each_giver_is_told(
    tmp_path: Path,
) -> None:
    chance = random.Random(1)
    in_force: Counter[str] = Counter()
    with plant_by_hand(tmp_path) as plant, Giver(tmp_path) as one, Giver(tmp_path) as other:
        for number in range(200):
            pair = [
                (giver, chance.choice(SOURCES), 2.0 * number % 150 + at)
                for at, giver in enumerate(chance.sample([one, other], 2))
            ]
            for giver, source, power_kw in pair:
                if source == OPERATOR:
                    plant.hear(operators_order(number, power_kw))
                else:
                    giver.give(source, power_kw)
                    giver.arrive()
            (older, old_source, _), (newer, new_source, newest_kw) = pair
            dispatch = plant.go_on()
            assert (dispatch.power_kw, dispatch.order_source) == (newest_kw, new_source)
            assert dispatch.order_replaced == (old_source,)
            if old_source != OPERATOR:
                reply = older.reply()
                assert not reply.is_in_force
                assert reply.text.startswith("replaced by ")
                assert reply.text.endswith(f"in cycle {number}")
            if new_source != OPERATOR:
                reply = newer.reply()
                assert reply.is_in_force
                assert reply.text.startswith(f"in force from cycle {number}, in place of ")
            in_force[new_source] += 1
    assert set(in_force) == set(SOURCES)


def test_a_given_order_counts_more_than_the_scenarios_of_its_cycle_and_both_are_named(
    tmp_path: Path,
) -> None:
    planned = (PlannedOrder(at=1.0, power_kw=30.0), PlannedOrder(at=2.0, power_kw=20.0))
    with plant_by_hand(tmp_path, *planned) as plant, Giver(tmp_path) as giver:
        assert plant.go_on().power_kw == SCHEDULED_KW
        giver.give("command", 50.0)
        giver.arrive()
        dispatch = plant.go_on()
        assert (dispatch.power_kw, dispatch.order_replaced) == (50.0, ("scenario",))
        assert "the scenario" in giver.reply().text
        dispatch = plant.go_on()
        assert (dispatch.power_kw, dispatch.order_replaced) == (20.0, ())


def test_a_thousand_orders_in_a_cycle_get_a_reply_each_and_the_newest_counts(
    tmp_path: Path,
) -> None:
    with plant_by_hand(tmp_path) as plant, ExitStack() as stack:
        givers = [stack.enter_context(Giver(tmp_path)) for _ in range(10)]
        for number in range(1_000):
            givers[number % 10].give("command", number / 10.0)
        for giver in givers:
            giver.arrive()
        assert plant.go_on().power_kw == 99.9
        found = [giver.reply() for giver in givers for _ in range(100)]
        assert sum(reply.is_in_force for reply in found) == 1
        assert {reply.text for reply in found if not reply.is_in_force} == {
            "replaced by `heliarch order` in cycle 0"
        }


def test_programs_may_leave_at_any_moment_and_their_orders_still_count(tmp_path: Path) -> None:
    chance = random.Random(2)
    with plant_by_hand(tmp_path) as plant, Giver(tmp_path) as stays:
        for number in range(300):
            for _ in range(3):
                with Giver(tmp_path) as leaving:
                    if chance.random() < 0.3:
                        plant.go_on()
                    for _ in range(chance.randrange(3)):
                        leaving.give("page", 10.0)
            with Giver(tmp_path) as last:
                last.give("command", float(number % 200))
            stays.arrive()
            while (dispatch := plant.go_on()).order_source != "command":
                pass  # The desk has not read what those who left have sent.
            assert dispatch.power_kw == float(number % 200)
            stays.give("modbus", 5.0)
            stays.arrive()
            plant.go_on()
            assert stays.reply().is_in_force


def test_a_program_that_reads_late_misses_statuses_but_no_reply(tmp_path: Path) -> None:
    with plant_by_hand(tmp_path) as plant, Giver(tmp_path) as giver, Giver(tmp_path) as other:
        for number in range(500):
            giver.give("command", float(number % 100))
            dispatch = None
            while dispatch is None or dispatch.order_power_kw != float(number % 100):
                other.arrive()
                dispatch = plant.go_on()
        replies = [giver.reply() for _ in range(500)]
        cycles = [
            int(one.text.removeprefix("in force from cycle ").replace(",", ""))
            for one in replies
            if one.is_in_force
        ]
        assert len(cycles) == 500
        assert cycles == sorted(set(cycles))


def test_an_order_after_the_last_cycle_is_refused(tmp_path: Path) -> None:
    with ExitStack() as stack:
        with plant_by_hand(tmp_path) as plant:
            giver = stack.enter_context(Giver(tmp_path))
            plant.go_on()
            giver.give("command", 50.0)
        assert giver.reply().text == "refused: the run is over"


def test_programs_beyond_those_that_the_desk_hears_at_once_wait_and_are_heard(
    tmp_path: Path,
) -> None:
    with plant_by_hand(tmp_path) as plant, ExitStack() as stack:
        first = [stack.enter_context(Giver(tmp_path)) for _ in range(64)]
        for giver in first:
            giver.arrive()
        late = stack.enter_context(Giver(tmp_path))
        late.give("command", 50.0)
        assert plant.go_on().order_source == ""
        first[7].raw.close()
        late.arrive()
        assert plant.go_on().power_kw == 50.0
