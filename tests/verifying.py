"""What the verification of a run of processes may find: on a slow machine, what the run admits."""

from __future__ import annotations

from running import Heliarch

from recordings.verify.verification import Verification


def first_differences(found: Verification) -> dict[str, object]:
    """The first difference of each agent that has one."""
    return {name: entry.first for name, entry in found.agents.items() if entry.first}


def assert_equal_as_far_as_recorded(run: Heliarch, found: Verification) -> None:
    """Fail if a run in real time, which is over, decided otherwise than its agents do in memory.

    On a machine that is busy elsewhere messages may not reach the recorder in time. Then the run
    says so and fails, and what is not in the recording is all that may be found.
    """
    if "messages were lost" not in run.error_text():
        is_given_up = "given up" in run.error_text()
        assert run.process.returncode in ({1} if is_given_up else {0, 130}), run.error_text()
        assert first_differences(found) == {}
        return
    assert run.process.returncode == 1
    kinds = {kind for result in found.agents.values() for kind in result.differences}
    assert kinds <= {"only new", "not recorded", "input not recorded"}
