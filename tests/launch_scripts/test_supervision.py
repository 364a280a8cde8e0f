"""Who lives, who is heard, who is started again and who is given up."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from signal import SIGKILL, Signals
from typing import Any, Literal, cast

import pytest
from plans_by_hand import REAL_TIME, plan_at_noon

from agents.plan import RunPlan
from agents.process.beats import FORK_SERVER, BeatTable
from agents.process.events import Exited, Joined, Presence, Started, Status, Waiting
from agents.settings import RestartPolicy
from bus_schemas.errors import FailureError
from bus_schemas.faults import Partition
from bus_schemas.tree import PLANT, RECORDER
from launch_scripts.hearing import Hearing
from launch_scripts.restarts import Restarts
from launch_scripts.supervision import Child, Children, still_waiting
from launch_scripts.watch import Externals, Watch

NODE = "c1/a"


class NoServer:
    """In place of the fork server: only its memory for beats."""

    def __init__(self) -> None:
        self.beats = os.memfd_create("beats")
        self.process = cast("Any", type("Process", (), {"pid": 1}))


class Watched:
    """A run whose processes beat as the test says, and what they were sent."""

    def __init__(self, plan: RunPlan, *, begun: bool = True) -> None:
        self.now_s = 1000.0
        self.cycle = 7
        self.said: list[str] = []
        self.started: list[str] = []
        self.sent: list[tuple[str, Signals]] = []
        own = [name for name in plan.processes if name not in plan.elsewhere]
        self.server = NoServer()
        self.children = Children(cast("Any", self.server), plan, own, Path("logs"))
        self.children.signal = self.signal  # type: ignore[method-assign]
        self.table: BeatTable = self.children.table
        self.watch = Watch(plan, self.children, lambda: self.now_s)
        self.restarts = Restarts(
            plan,
            self.children,
            self.watch,
            self.started.append,
            self.said.append,
            lambda: self.now_s,
        )
        self.hearing = Hearing(
            plan,
            self.children,
            self.watch,
            self.restarts,
            self.said.append,
        )
        for name in own:
            self.joins(name)
        if begun:
            self.restarts.begin(self.now_s)

    def __getitem__(self, name: str) -> Child:
        return self.children[name]

    def signal(self, agents: Sequence[str], number: Signals) -> None:
        self.sent += [(agent, number) for agent in agents]

    def joins(self, name: str) -> None:
        for event in (Started(2**22 + 1), Joined()):  # No process has this number.
            self[name].note(event)
            self.watch.hear(self[name], event)

    def pass_by(
        self,
        seconds: float,
        *silent: str,
        step_s: float = 0.25,
        status: Status | None = None,
        stuck: Sequence[str] = (),
    ) -> None:
        """Let time pass in which all but some processes beat."""
        for _ in range(round(seconds / step_s)):
            self.now_s += step_s
            self.cycle += 1
            for child in self.children:
                if child.agent not in silent and child.exited is None:
                    self.table.beat(child.agent, 7 if child.agent in stuck else self.cycle)
            self.table.beat(FORK_SERVER)
            self.restarts.look()
            if status is not None:
                self.hearing.hear(status)

    def dies(self, name: str, status: int = -9) -> bool:
        self[name].exited = Exited(status, 0.0)
        return self.restarts.on_death(self[name], f"{name} ended")

    def got(self, number: Signals) -> list[str]:
        return [name for name, sent in self.sent if sent == number]


@pytest.fixture
def watched() -> Iterator[Callable[..., Watched]]:
    made: list[Watched] = []

    def make(*, begun: bool = True, **changes: Any) -> Watched:
        defaults: dict[str, Any] = {"cycle_wall_ns": REAL_TIME}
        made.append(Watched(plan_at_noon(**defaults | changes | {"cycles": 10**6}), begun=begun))
        return made[-1]

    yield make
    for one in made:
        os.close(one.server.beats)


Make = Callable[..., Watched]


def test_a_process_is_killed_when_it_does_not_beat_whatever_is_heard_of_it(watched: Make) -> None:
    run = watched()
    deaf = Status(7, 0, 0.0, 0.0, 0.0, [], 0, not_recorded=["central", "c1", "c2", NODE])
    run.pass_by(60.0, status=deaf)
    assert run.got(SIGKILL) == []
    run.pass_by(5.0, "c2")
    assert run.got(SIGKILL) == []
    run.pass_by(1.5, "c2")
    assert run.got(SIGKILL) == ["c2"]


def test_a_process_that_beats_and_stays_in_a_cycle_is_wedged(watched: Make) -> None:
    run = watched()
    run.pass_by(12.0, stuck=["central"])
    assert run.got(SIGKILL) == ["central"]


def test_time_in_which_the_launcher_itself_stood_still_proves_nothing(watched: Make) -> None:
    run = watched()
    for _ in range(3):
        run.pass_by(90.0, "central", "c1", "c2", step_s=90.0)
        run.pass_by(0.5)
    assert run.got(SIGKILL) == []


def test_a_machine_that_is_too_busy_starts_no_storm_of_kills(watched: Make) -> None:
    run = watched()
    everybody = [child.agent for child in run.children if child.agent != PLANT]
    run.pass_by(8.0, *everybody)
    assert 1 <= len(run.got(SIGKILL)) <= 3 < len(everybody)


def test_the_plant_alone_ends_a_run_and_only_if_it_does_not_beat(watched: Make) -> None:
    run = watched()
    run.pass_by(9.0, PLANT)
    with pytest.raises(FailureError, match=r"^plant .* has not beaten"):
        run.pass_by(3.0, PLANT)


def test_in_lockstep_who_waits_to_send_is_not_silent(watched: Make) -> None:
    run = watched(cycle_wall_ns=0)
    run.table.sends("c2")[0] = True
    run.pass_by(60.0, "c2", stuck=["central", "c1"])
    assert run.got(SIGKILL) == []


def test_the_processor_time_of_an_agent_is_that_of_all_its_processes(watched: Make) -> None:
    run = watched()
    run[NODE].cpu_at_start_s = 0.5
    for cpu_s in (2.5, 1.0):
        run[NODE].exited = Exited(-9, cpu_s)
        assert run.restarts.on_death(run[NODE], "it ended")
        run.pass_by(2.0)
        run.joins(NODE)
    run[NODE].exited = Exited(0, 0.25)
    assert run[NODE].cpu_in_run_s() == pytest.approx(2.0 + 1.0 + 0.25)


def test_a_fork_server_that_stands_still_is_named_once(watched: Make) -> None:
    run = watched()
    run.pass_by(1.0)
    for _ in range(90):
        run.now_s += 0.25
        for child in run.children:
            run.table.beat(child.agent, run.cycle)
            run.cycle += 1
        run.restarts.look()
    assert [line for line in run.said if "fork server" in line] == run.said[:1]


# Who is heard -------------------------------------------------------------------------------------


def not_heard(*names: str) -> Status:
    return Status(7, 0, 0.0, 0.0, 0.0, [], 0, not_heard=[*names])


def test_a_live_process_that_no_listener_hears_is_started_again(watched: Make) -> None:
    run = watched()
    run.pass_by(11.0, status=not_heard(NODE, PLANT))
    run.pass_by(1.0, status=not_heard())
    run.pass_by(11.0, status=not_heard(NODE, PLANT))
    assert run.got(SIGKILL) == []
    run.pass_by(2.0, status=not_heard(NODE, PLANT))
    assert run.got(SIGKILL) == [NODE]


def test_one_that_stays_away_is_given_up_and_the_run_goes_on(watched: Make) -> None:
    run = watched(restart=RestartPolicy(most=2))
    for patience_s in (12.0, 24.0):
        run.pass_by(patience_s - 1.0, status=not_heard(NODE))
        assert NODE not in run.restarts.given_up
        run.pass_by(2.0, status=not_heard(NODE))
        assert run.dies(NODE), "the run goes on"
        run.joins(NODE)
    run.pass_by(50.0, status=not_heard(NODE))
    assert run.dies(NODE)
    assert run.restarts.counts == {NODE: 2}
    assert [*run.restarts.given_up] == [NODE]


def test_where_a_fault_rule_cuts_links_nobody_is_started_again_for_it(watched: Make) -> None:
    run = watched(faults=(Partition(("central", "c1")),))
    run.pass_by(60.0, status=not_heard("c1"))
    assert run.got(SIGKILL) == []


@pytest.mark.parametrize("others", [(), ("central", "c1", "c2", "c1/a", "c1/b", "c2/c", "c2/d")])
def test_a_recorder_that_does_not_hear_the_plant_is_cut_off_and_the_gap_is_named(
    watched: Make, others: tuple[str, ...]
) -> None:
    run = watched()
    run.cycle = 40
    run.pass_by(14.0, status=Status(41, 0, 0.0, 0.0, 0.0, [], 0, not_recorded=[PLANT, *others]))
    assert run.sent == []
    run.pass_by(1.0, status=Status(81, 0, 0.0, 0.0, 0.0, [], 0))
    assert run.hearing.gaps == [(42, 80)]
    assert sum("cut off" in line for line in run.said) == 1


# Who is started again -----------------------------------------------------------------------------


def test_each_restart_waits_longer_until_the_process_is_given_up(watched: Make) -> None:
    run = watched()
    for number, wait_s in enumerate((0.0, 0.5, 1.0, 2.0, 4.0), start=1):
        assert run.dies(NODE)
        run.pass_by(wait_s)
        assert run.started == [NODE] * number
        run.joins(NODE)
    run.pass_by(1.0)
    assert run.dies(NODE), "the run goes on without it"
    assert run.restarts.given_up == {NODE: run.cycle}
    assert run.table.given_up() == (NODE,)
    assert not run.dies(PLANT), "but not without the plant"


@pytest.mark.parametrize(
    ("when", "status", "goes_on"),
    [(None, -9, True), ("never", -9, False), (None, 1, True)],
)
def test_a_process_that_dies_before_cycle_0_is_started_again_also_in_lockstep(
    watched: Make, when: Literal["never"] | None, status: int, goes_on: bool
) -> None:
    run = watched(begun=False, cycle_wall_ns=0, restart=RestartPolicy(when=when))
    assert run.dies(NODE, status) == goes_on
    assert run.started == [NODE] * goes_on


def test_in_lockstep_a_controller_is_given_up_at_once_and_a_recorder_comes_back(
    watched: Make,
) -> None:
    run = watched(cycle_wall_ns=0)
    assert run.dies("c2")
    assert run.dies(RECORDER)
    assert (run.table.given_up(), run.started) == (("c2",), [RECORDER])


def test_at_the_end_nobody_is_started_again_and_nobody_who_dies_fails_the_run(
    watched: Make,
) -> None:
    run = watched()
    run.dies("c2")
    run.joins("c2")
    run.dies("c2")  # This restart is to wait.
    run.restarts.end()
    assert run["c2"].exited is not None
    assert run.dies("central")
    assert run.started == ["c2"]
    assert run.restarts.lost_processes


# External agents ----------------------------------------------------------------------------------


def test_external_agents_are_awaited_until_each_was_seen_once() -> None:
    told: list[str] = []
    found = Externals(plan_at_noon(external=(NODE, "central")), told.append, lambda: 161.0)
    found.hear(Presence(NODE, True, -1))
    assert (found.complete_at, found.awaited) == (None, ["central"])
    found.hear(Presence("central", True, -1))
    assert (found.complete_at, found.awaited, len(told)) == (161.0, [], 2)


@pytest.mark.parametrize(
    ("agent", "cycle_wall_ns", "gone"),
    [
        (PLANT, 0, [True, True]),
        (NODE, 0, [True, True]),
        (PLANT, REAL_TIME, [True, False]),
        (NODE, REAL_TIME, [False, False]),
    ],
)
def test_a_run_fails_without_its_plant_and_in_lockstep_after_the_loss_of_any_device(
    agent: str, cycle_wall_ns: int, gone: list[bool]
) -> None:
    for comes_back in (False, True):
        told: list[str] = []
        now_s = [100.0]
        plan = plan_at_noon(external=(agent,), cycle_wall_ns=cycle_wall_ns)
        found = Externals(plan, told.append, lambda now_s=now_s: now_s[0])  # type: ignore[misc]
        for alive, cycle in ((True, -1), (False, -1), (True, 3), (False, 41)):
            found.hear(Presence(agent, alive, cycle))
        if comes_back:
            found.hear(Presence(agent, True, 42))
        assert found.failure() is None
        now_s[0] += 3.0
        assert (found.failure() is not None) == gone[comes_back]


def test_who_waited_and_has_gone_on_does_not_stall_the_run() -> None:
    run = Watched(plan_at_noon())
    child = run["c1"]
    child.waiting = Waiting(run.cycle, "report", [("c1/a/impp", "c1/a")])
    child.row.cycle = run.cycle
    assert still_waiting(run.children) == [child]
    child.row.cycle += 1
    assert still_waiting(run.children) == []
    assert child.waiting is None
