"""What recorder and listeners say of wrong messages is brought together by key and cause."""

from __future__ import annotations

from plans_by_hand import plan_at_noon

from agents.events import Complaint
from launch_scripts.launcher.wrong_messages import one_line_each, wrong_messages

PLAN = plan_at_noon(external=("c1/a",))


def test_of_recorder_and_listeners_the_larger_count_holds_and_processes_may_be_late() -> None:
    complaints = [Complaint("oahu/c1/a/impp", "duplicate", 5, "it came twice in cycle 3")]
    dropped = [
        ("c1/a/impp", "duplicate", 4),
        ("c1/a/impp", "late", 2),
        ("c1/b/impp", "late", 9),
        ("c1/a/impp", "late", 1),
    ]
    found = wrong_messages(PLAN, complaints, dropped)
    assert [(w.key, w.cause, w.count, w.example) for w in found] == [
        ("c1/a/impp", "duplicate", 5, "it came twice in cycle 3"),
        ("c1/a/impp", "late", 3, "older than the newest one"),
    ]


def test_one_thing_that_a_device_does_wrong_is_one_line() -> None:
    signals = ("impp", "residual", "help", "command")
    counts = {"late": 2, "foreign": 1}.items()
    dropped = [(f"c1/a/{signal}", *count) for signal in signals for count in counts]
    complaints = [Complaint("oahu/nobody/impp", "unknown", 3, "no such node")]
    late, foreign, unknown = one_line_each(wrong_messages(PLAN, complaints, dropped))
    assert (late.cause, late.count, foreign.cause, foreign.count) == ("late", 8, "foreign", 4)
    assert late.key.startswith("c1/a/")
    assert late.key.endswith(" and 3 more")
    assert (unknown.key, unknown.count) == ("nobody/impp", 3)
