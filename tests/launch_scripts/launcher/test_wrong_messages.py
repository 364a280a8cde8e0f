"""What recorder and listeners say of wrong messages is brought together by key and cause."""

from __future__ import annotations

from agents.events import Complaint
from launch_scripts.launcher.wrong_messages import one_line_each, wrong_messages
from launch_scripts.scenarios.preparation import RunOptions, prepare
from launch_scripts.scenarios.scenario import load_scenario

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
