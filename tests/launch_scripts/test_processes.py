"""Who lives, who is heard, who is started again and who is given up."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from signal import SIGKILL, Signals
from typing import Any, Literal, cast

import msgspec
import pytest
from plans_by_hand import REAL_TIME, plan_at_noon

from agents.plan import RunPlan
from agents.process.beats import FORK_SERVER, BeatTable
from agents.process.events import (
    Armed,
    Event,
    Exited,
    Joined,
    Presence,
    Request,
    SendSignal,
    Start,
    Started,
    Status,
)
from agents.settings import RestartPolicy
from bus_schemas.errors import FailureError
from bus_schemas.tree import PLANT, RECORDER
from launch_scripts.process_record import Process
from launch_scripts.processes import GONE_S, Processes
from launch_scripts.run_folder import RunFolder

NODE = "c1/a"
NOBODY = 2**22 + 1
"""No process has this number."""


class ServerByHand:
    """In place of the fork server: the test says what its processes do."""

    def __init__(self) -> None:
        self.control, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.control.setblocking(False)
        self.theirs.setblocking(False)
        self.beats = os.memfd_create("beats")
        self.name = "fork server"
        self.side = cast("Any", self)
        self.process = cast("Any", type("Process", (), {"poll": lambda self: None})())
        self.links: dict[str, socket.socket] = {}
        self._asked: list[Request] = []

    @property
    def asked(self) -> list[Request]:
        """Everything that it was asked for; each start is answered."""
        with suppress(BlockingIOError):
            while True:
                request = msgspec.json.decode(self.theirs.recv(4096), type=Request)
                self._asked.append(request)
                if isinstance(request, Start):
                    ours, self.links[request.agent] = socket.socketpair()
                    with ours:
                        self.tell(Started(request.agent, NOBODY), ours)
        return self._asked

    def tell(self, event: Event, *links: socket.socket) -> None:
        numbers = [link.fileno() for link in links]
        socket.send_fds(self.theirs, [msgspec.json.encode(event)], numbers)

    def end(self) -> None:
        for one in (*self.links.values(), self.control, self.theirs):
            one.close()
        os.close(self.beats)


class Watched:
    """A run whose processes beat as the test says, and what was done to them."""

    def __init__(
        self, plan: RunPlan, folder: Path, *, begun: bool = True, joined: bool = True
    ) -> None:
        self.now_s = 1000.0
        self.cycle = 7
        self.said: list[str] = []
        own = [name for name in plan.processes if name not in plan.elsewhere]
        self.server = ServerByHand()
        self.processes = Processes(
            cast("Any", self.server),
            plan,
            own,
            RunFolder(folder),
            self.said.append,
            lambda: self.now_s,
        )
        self.table: BeatTable = self.processes.table
        self.processes.start()
        for name in own if joined else ():
            self.joins(name)
        if begun:
            self.tells(PLANT if PLANT in own else own[0], Armed(round(self.now_s * 1e9)))

    def __getitem__(self, name: str) -> Process:
        return self.processes[name]

    @property
    def started(self) -> list[str]:
        """Those that were started again, in this order."""
        names = [one.agent for one in self.server.asked if isinstance(one, Start)]
        return names[len(self.processes.own) :]

    def tells(self, name: str, event: Event) -> None:
        self.look()
        self.server.links[name].send(msgspec.json.encode(event) + b"\n")
        self.look()

    def look(self) -> None:
        self.processes.look(0.0)
        if self.server.asked:  # What it answers is heard at once.
            self.processes.look(0.0)

    def joins(self, name: str) -> None:
        self.tells(name, Joined())

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
            for process in self.processes.own:
                if process.name not in silent and process.exited is None:
                    self.table.beat(process.name, 7 if process.name in stuck else self.cycle)
            self.table.beat(FORK_SERVER)
            if status is not None:
                self.tells(RECORDER, status)
            else:
                self.look()

    def dies(self, name: str, status: int = -9, cpu_s: float = 0.0) -> None:
        self.server.links[name].close()
        self.server.tell(Exited(name, status, cpu_s))
        self.look()

    def got(self, number: Signals) -> list[str]:
        return [
            one.agent
            for one in self.server.asked
            if isinstance(one, SendSignal) and one.number == number
        ]


@pytest.fixture
def watched(tmp_path: Path) -> Iterator[Callable[..., Watched]]:
    made: list[Watched] = []

    def make(*, begun: bool = True, joined: bool = True, **changes: Any) -> Watched:
        plan = plan_at_noon(**{"cycle_wall_ns": REAL_TIME} | changes | {"cycles": 10**6})
        made.append(Watched(plan, tmp_path, begun=begun, joined=joined))
        return made[-1]

    yield make
    for one in made:
        one.server.end()


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
    everybody = [process.name for process in run.processes.own if process.name != PLANT]
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


# Before cycle 0 -----------------------------------------------------------------------------------


def test_a_process_that_freezes_while_it_arms_is_named_itself(watched: Make) -> None:
    run = watched(begun=False)
    run.pass_by(7.0, "c2")
    assert run.got(SIGKILL) == ["c2"]
    assert all(line.startswith("c2 ") for line in run.said)


def test_a_process_that_does_not_come_onto_the_bus_is_started_again_once_and_then_named(
    watched: Make,
) -> None:
    run = watched(begun=False, joined=False)
    for name in ("c1/b", "c2/c", "c2/d", "c1", "c2", "central", PLANT, RECORDER):
        run.pass_by(8.0, NODE)
        run.joins(name)
    assert run.got(SIGKILL) == [], "others have come meanwhile"
    run.pass_by(11.0, NODE)
    assert run.got(SIGKILL) == [NODE]
    assert run.processes.stuck_start() is None
    run.dies(NODE)
    run.pass_by(11.0, NODE)
    failure = run.processes.stuck_start()
    assert failure is not None
    assert NODE in str(failure)


def test_a_start_in_which_nobody_comes_onto_the_bus_fails_after_ten_seconds(watched: Make) -> None:
    run = watched(begun=False, joined=False)
    run.pass_by(11.0, *[process.name for process in run.processes.own])
    assert run.got(SIGKILL) == [], "no single one is to blame"
    assert run.processes.stuck_start() is not None


def test_agents_from_whom_nothing_comes_in_arming_rounds_are_named(watched: Make) -> None:
    run = watched(begun=False)
    for number in (5, 4, 3, 2):
        run.pass_by(8.0, status=Status(-1, 0, 0, 0, 0, [], 0, never_heard=([NODE, "c2"], number)))
    assert run.processes.stuck_start() is None, "somebody answered for the first time"
    run.pass_by(11.0, status=Status(-1, 0, 0, 0, 0, [], 0, never_heard=([NODE, "c2"], 2)))
    failure = run.processes.stuck_start()
    assert failure is not None
    assert f"{NODE}, c2" in str(failure)


def test_of_a_recorder_that_ends_before_cycle_0_no_file_is_left(
    watched: Make, tmp_path: Path
) -> None:
    run = watched(begun=False)
    for name in ("run.mcap", "run-2.mcap"):
        (tmp_path / name).touch()
    run.dies(RECORDER)
    run.pass_by(2.0)
    assert run.started == [RECORDER]
    assert [*tmp_path.glob("*.mcap")] == []


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


def test_a_process_that_stays_away_is_given_up_and_the_run_goes_on(watched: Make) -> None:
    run = watched(restart=RestartPolicy(most=2))
    for patience_s in (12.0, 24.0):
        run.pass_by(patience_s - 1.0, status=not_heard(NODE))
        assert run.processes.given_up == {}
        run.pass_by(2.0, status=not_heard(NODE))
        run.dies(NODE)
        run.pass_by(1.0)
        run.joins(NODE)
    run.pass_by(50.0, status=not_heard(NODE))
    run.dies(NODE)
    assert run.processes.restarts() == {NODE: 2}
    assert [*run.processes.given_up] == [NODE]


# Who is started again -----------------------------------------------------------------------------


def test_each_restart_waits_longer_until_the_process_is_given_up(watched: Make) -> None:
    run = watched()
    for number, wait_s in enumerate((0.0, 0.5, 1.0, 2.0, 4.0), start=1):
        run.dies(NODE)
        run.pass_by(wait_s)
        assert run.started == [NODE] * number
        run.joins(NODE)
    run.pass_by(1.0)
    run.dies(NODE)
    assert run.processes.given_up == {NODE: run.cycle}, "the run goes on without it"
    assert run.table.given_up() == (NODE,)
    with pytest.raises(FailureError, match=r"^plant "):
        run.dies(PLANT)


def test_restarts_of_long_ago_do_not_count(watched: Make) -> None:
    run = watched(restart=RestartPolicy(most=2, within_s=60.0))
    for number in range(1, 5):
        run.dies(NODE)
        assert run.started == [NODE] * number
        run.joins(NODE)
        run.pass_by(61.0)
    assert run.processes.given_up == {}


@pytest.mark.parametrize(
    ("when", "status", "goes_on"),
    [(None, -9, True), ("never", -9, False), (None, 1, True)],
)
def test_a_process_that_dies_before_cycle_0_is_started_again_also_in_lockstep(
    watched: Make, when: Literal["never"] | None, status: int, goes_on: bool
) -> None:
    run = watched(begun=False, cycle_wall_ns=0, restart=RestartPolicy(when=when))
    with nullcontext() if goes_on else pytest.raises(FailureError, match=NODE):
        run.dies(NODE, status)
    run.pass_by(0.5, NODE)
    assert run.started == [NODE] * goes_on


def test_in_lockstep_a_controller_is_given_up_at_once_and_a_recorder_comes_back(
    watched: Make,
) -> None:
    run = watched(cycle_wall_ns=0)
    run.dies("c2")
    run.dies(RECORDER)
    run.pass_by(0.5, RECORDER)
    assert (run.table.given_up(), run.started) == (("c2",), [RECORDER])


# External agents ----------------------------------------------------------------------------------


def test_external_agents_are_awaited_until_each_was_seen_once(watched: Make) -> None:
    run = watched(begun=False, external=(NODE, "central"))
    run.tells(RECORDER, Presence(NODE, True, -1))
    assert run.processes.awaited == ["central"]
    run.tells(RECORDER, Presence("central", True, -1))
    assert (run.processes.awaited, len(run.said)) == ([], 2)


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
    watched: Make, agent: str, cycle_wall_ns: int, gone: list[bool]
) -> None:
    for comes_back in (False, True):
        run = watched(external=(agent,), cycle_wall_ns=cycle_wall_ns)
        for alive, cycle in ((True, -1), (False, -1), (True, 3), (False, 41)):
            run.tells(RECORDER, Presence(agent, alive, cycle))
        if comes_back:
            run.tells(RECORDER, Presence(agent, True, 42))
        assert run.processes.lost_external() is None
        run.now_s += GONE_S + 0.1
        assert (run.processes.lost_external() is not None) == gone[comes_back]
        assert any("goes on without it" in line for line in run.said) == (gone == [False, False])


# A run in lockstep that stalls --------------------------------------------------------------------


def test_a_process_that_is_always_started_again_waits_no_longer_than_the_policy_counts() -> None:
    policy = RestartPolicy(when="always", within_s=60.0)
    assert policy.wait_s([0.0] * 2000, 1.0) == 60.0


def test_a_fork_server_that_stands_still_is_named_once(watched: Make) -> None:
    run = watched()
    run.pass_by(1.0)
    for _ in range(90):
        run.now_s += 0.25
        run.cycle += 1
        for process in run.processes.own:
            run.table.beat(process.name, run.cycle)
        run.processes.look(0.0)
    assert [line for line in run.said if "fork server" in line] == run.said[:1]
