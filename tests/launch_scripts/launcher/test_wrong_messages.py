"""What recorder and listeners say of wrong messages is brought together by key and cause."""

from __future__ import annotations

from agents.events import Complaint
from launch_scripts.launcher.wrong_messages import one_line_each, wrong_messages
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario
from recordings.record.message_complaints import Complaints

OPTIONS = RunOptions(duration="5", external=["c1/inv01"])
PLAN = prepare(load_scenario("oahu"), OPTIONS, "wrong").plan


def test_of_recorder_and_listeners_the_larger_count_holds() -> None:
    complaints = [Complaint("oahu/c1/inv01/impp", "duplicate", 5, "it came twice in cycle 3")]
    dropped = [
        {"c1/inv01/impp": {"duplicate": 4, "late": 2}},
        {"c1/inv01/impp": {"late": 1}},
    ]
    found = wrong_messages(PLAN, complaints, dropped)
    assert [(w.key, w.cause, w.count) for w in found] == [
        ("c1/inv01/impp", "duplicate", 5),
        ("c1/inv01/impp", "late", 3),
    ]
    assert found[0].example == "it came twice in cycle 3"
    assert found[1].example == "older than the newest one"


def test_what_comes_late_from_processes_is_no_device_s_fault() -> None:
    assert wrong_messages(PLAN, [], [{"c1/inv04/impp": {"late": 9}}]) == ()


def test_two_messages_of_a_process_in_a_cycle_are_of_two_senders_unless_it_was_replaced() -> None:
    dropped = [{"c1/setpoint": {"duplicate": 2}}, {"c1/setpoint": {"duplicate": 1}}]
    (found,) = wrong_messages(PLAN, [], dropped)
    assert (found.key, found.cause, found.count) == ("c1/setpoint", "two senders", 3)
    assert wrong_messages(PLAN, [], dropped, replaced=True) == ()


def test_complaints_are_told_once_and_counted_by_key_and_cause() -> None:
    log: list[str] = []
    told: list[Complaint] = []
    complaints = Complaints(log.append, told.append)
    for cycle in range(3):
        complaints.add("oahu/c1/inv01/impp", "absurd", f"power_kw is {cycle - 9}")
    complaints.add("oahu/nobody/impp", "unknown", "no such node")
    assert len(log) == 4
    assert [(entry.key, entry.count, entry.example) for entry in complaints.all()] == [
        ("oahu/c1/inv01/impp", 3, "power_kw is -9"),
        ("oahu/nobody/impp", 1, "no such node"),
    ]
    assert len(told) == 2
    assert complaints.set_aside == 1, "absurd ones are in the recording"


def test_one_thing_that_a_device_does_wrong_is_one_line() -> None:
    signals = ("impp", "residual", "help", "command")
    dropped = [{f"c1/inv01/{signal}": {"late": 2, "foreign": 1} for signal in signals}]
    complaints = [Complaint("oahu/nobody/impp", "unknown", 3, "no such node")]
    found = wrong_messages(PLAN, complaints, dropped)
    assert (len(found), found[-1].publisher) == (9, "c1/inv01")
    late, foreign, unknown = one_line_each(found)
    assert (late.cause, late.count) == ("late", 8)
    assert (foreign.cause, foreign.count) == ("foreign", 4)
    assert late.key.startswith("c1/inv01/")
    assert late.key.endswith(" and 3 more")
    assert (unknown.key, unknown.count) == ("nobody/impp", 3)
