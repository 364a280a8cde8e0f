"""What processes count of themselves lies in a recording beside what agents decide, unverified."""

from __future__ import annotations

from pathlib import Path

from troubled_runs import cloudy_profile, lockstep_run, plan_of, record

from bus_schemas.bus import Delivery
from bus_schemas.messages import Timing
from bus_schemas.signals import IMPP, PLANT_TIMING, TIMING
from bus_schemas.tree import CENTRAL, PLANT, ROOT
from launch_scripts.verification.comparison import Comparison
from launch_scripts.verification.verification import verify
from recordings.completeness import due_step

PLAN = plan_of(cycles=8)
PROFILE = cloudy_profile(PLAN)
SAID = lockstep_run(PLAN, PROFILE)


def counts(source: str, cycle: int, missed: int) -> Timing:
    return Timing(
        cycle,
        PLAN.sim_time_ns(cycle),
        source,
        (),
        missed_deadlines=missed,
        missing_inputs=missed,
        late_used=0,
        overruns=0,
        dropped=0,
        slowest_decision_ns=1_000_000,
    )


def with_counts() -> list[Delivery]:
    """What was said, with counts in between: also such as run ahead, and after the end."""
    said: list[Delivery] = []
    for port, message in SAID:
        said.append((port, message))
        if port is IMPP.of("c1/a") and message.cycle % 3 == 0:
            said.append((TIMING.of("c1/a"), counts("c1/a", message.cycle, message.cycle)))
        if port is IMPP.of(ROOT) and message.cycle == 5:
            said.append((TIMING.of(ROOT), counts(CENTRAL, 5, 1)))
            said.append((TIMING.of("c1/a"), counts("c1/a", PLAN.cycles - 1, 9)))
    return [*said, (PLANT_TIMING.of(ROOT), counts(PLANT, PLAN.cycles - 1, 2))]


def test_a_recording_with_counts_in_it_is_equal(tmp_path: Path) -> None:
    without = verify(record(tmp_path / "without", PLAN, SAID, PROFILE), (), Comparison())
    found = verify(record(tmp_path / "with", PLAN, with_counts(), PROFILE), (), Comparison())
    assert found.equal
    assert found.strays == found.not_compared == 0
    assert found.compared == without.compared
    assert (found.last_cycle, found.cycles) == (without.last_cycle, without.cycles)
    assert found.recorded == without.recorded + len(with_counts()) - len(SAID)


def test_counts_are_due_in_no_cycle() -> None:
    assert due_step(PLAN, TIMING.of("c1")) == due_step(PLAN, PLANT_TIMING.of(ROOT)) == 0
