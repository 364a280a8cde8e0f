"""`heliarch replay --live`: the named controllers as processes, and what they say compared."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TextIO

import msgspec

from agents.plan import RunPlan, load_plan
from bus_schemas.errors import InputError
from bus_schemas.tree import agent_name
from launch_scripts.commands.boundary import FAILED, INTERRUPTED, OK
from launch_scripts.commands.output import write_json
from launch_scripts.launcher.fork_requests import Start
from launch_scripts.launcher.interruption import Interruption, interruptible
from launch_scripts.launcher.supervision import Children, ForkServerProcess, RunFailure
from launch_scripts.launcher.tcp_ports import reserved_ports
from recordings.read.moments import RunClock
from recordings.read.selection import find_nodes
from recordings.replay.absent_agents import AbsentAgents, live_plan
from recordings.replay.figures import TimingFigures, print_timing
from recordings.replay.live import LiveReplay
from recordings.replay.progress import ProgressLine
from recordings.replay.recorded_run import RecordedRun
from recordings.replay.selection import select
from recordings.replay.session import await_subscriber, introduce, replay_session
from recordings.verify.account import Account
from recordings.verify.outcome import account_data, finding_lines

_NAMED: Final = 5
"""So many controllers are named before the rest is counted."""

_ABSENT: Final = "absent"
_SHARED: Final = (
    "plant",
    "inverters",
    "start_time_ns",
    "cycle_ns",
    "cycle_wall_ns",
    "period_cycles",
)
"""Fields in which the plan of the live controllers must be that of the run: the others keep to
it."""


@dataclass(frozen=True, slots=True)
class LiveRequest:
    """The values of the options, None where they were not given."""

    run: Path
    end: str | None
    wait: bool
    listen: str | None
    live: str
    plan: Path | None
    json: str | None


class LiveFigures(msgspec.Struct, frozen=True):
    """What a live replay came to.

    Attributes
    ----------
    compared
        Pairs of messages, new and recorded, of the live controllers.
    differing
        Messages that differ or lack their counterpart, by controller.
    agents
        What the comparison of each came to, as `heliarch verify --json` has it.
    timing_error
        Of the recorded messages, in real time.
    """

    run_id: str
    recording: str
    live: list[str]
    cycles: int
    wall_s: float
    compared: int
    differing: dict[str, int]
    agents: list[dict[str, Any]]
    timing_error: TimingFigures | None
    interrupted: bool


def replay_live(request: LiveRequest, out: TextIO) -> int:
    """Replay a recording with live controllers. Returns the exit status."""
    with RecordedRun(request.run) as recorded:
        return _replay_live(request, recorded, out)


def _replay_live(request: LiveRequest, recorded: RecordedRun, out: TextIO) -> int:
    """Replay with live controllers, and say in what they differ. Returns the exit status.

    Raises
    ------
    InputError
        A name that is no controller of the run, or a plan of another plant.
    RunFailure
        A live controller died, gave up, or says nothing any more.
    """
    live = _live_agents(recorded.plan, request.live)
    plan = _plan(request, recorded)
    introduce(recorded, out)
    out.write(f"live: {_named(live)}; all others do as recorded, whatever these say\n")
    with interruptible() as interruption, _folder() as folder:
        began_at = time.monotonic()
        replay = _run(request, recorded, plan, live, folder, interruption, out)
        wall_s = time.monotonic() - began_at
    accounts = replay.comparison.accounts
    figures = LiveFigures(
        plan.run_id,
        str(recorded.path),
        list(live),
        replay.cycles,
        wall_s,
        sum(account.compared for account in accounts.values()),
        {name: found.counts.total() for name, found in accounts.items() if found.counts},
        [account_data(name, account) for name, account in accounts.items()],
        replay.timing.figures(),
        bool(interruption),
    )
    _print(figures, accounts, plan, out)
    write_json(figures, request.json)
    if interruption:
        return INTERRUPTED
    return FAILED if figures.differing else OK


@contextmanager
def _folder() -> Iterator[Path]:
    """Make a folder for plan and logs; it is left if the replay fails, so that one can see why."""
    folder = Path(tempfile.mkdtemp(prefix="heliarch-replay-"))
    try:
        yield folder
    except RunFailure as failure:
        raise RunFailure(f"{failure}\nlogs of the live controllers: {folder}") from None
    except BaseException:
        shutil.rmtree(folder)
        raise
    shutil.rmtree(folder)


def _run(
    request: LiveRequest,
    recorded: RecordedRun,
    plan: RunPlan,
    live: Sequence[str],
    folder: Path,
    interruption: Interruption,
    out: TextIO,
) -> LiveReplay:
    with (
        ForkServerProcess() as server,
        reserved_ports((_ABSENT, *live)) as tcp_ports,
        Children(server, plan, live, folder) as children,
    ):
        told = live_plan(plan, live, tcp_ports, tcp_ports[_ABSENT])
        path = folder / "plan.json"
        path.write_bytes(told.as_json())
        with (
            replay_session(recorded, select(plan), None, request.listen, out) as observers,
            AbsentAgents(told, live, tcp_ports[_ABSENT]) as absent,
        ):
            server.ask(Start(str(path), tuple(live), str(folder), 0.0))
            progress = ProgressLine(out, plan)
            replay = LiveReplay(
                recorded, told, live, children, absent, observers, interruption, progress
            )
            replay.arm()
            if request.wait:
                await_subscriber(observers, interruption, out)
            replay.run()
            progress.close()
    return replay


def _live_agents(plan: RunPlan, text: str) -> tuple[str, ...]:
    names = dict.fromkeys(name.strip() for name in text.split(","))
    try:
        return tuple(agent_name(node) for node in find_nodes(plan.tree, names))
    except InputError as error:
        raise InputError(f"--live: {error}") from None


def _plan(request: LiveRequest, recorded: RecordedRun) -> RunPlan:
    """Return the plan that the live controllers run by, with the cycles to replay."""
    if not recorded.complete_cycles:
        raise InputError(f"{recorded.path}: no complete cycle, expected a run that has one")
    cycles = recorded.clock.span(None, request.end).stop
    plan = recorded.plan
    if request.plan is not None:
        plan = load_plan(request.plan)
        for field in _SHARED:
            found, wanted = getattr(plan, field), getattr(recorded.plan, field)
            if found != wanted:
                raise InputError(
                    f"{request.plan}: {field} is {_brief(found)}, accepted is that of the recorded "
                    f"run, {_brief(wanted)}"
                )
    return msgspec.structs.replace(
        plan, run_id=recorded.plan.run_id, cycles=min(cycles, recorded.complete_cycles)
    )


def _brief(value: object) -> str:
    text = str(value)
    return text if len(text) <= 40 else f"{text[:40]}..."


def _print(figures: LiveFigures, accounts: dict[str, Account], plan: RunPlan, out: TextIO) -> None:
    out.write(
        f"compared {figures.compared:,} messages of {len(figures.live)} live controllers over "
        f"{figures.cycles:,} cycles in {figures.wall_s:.1f} s\n"
    )
    print_timing(figures.timing_error, out)
    if not figures.differing:
        out.write("no difference\n")
        return
    clock = RunClock(plan, figures.cycles - 1)
    for name, account in accounts.items():
        for line in finding_lines(name, account, clock):
            out.write(f"{line}\n")
    most_first = sorted(figures.differing.items(), key=lambda entry: (-entry[1], entry[0]))
    counts = _named([f"{agent} {count:,}" for agent, count in most_first])
    out.write(f"messages that differ: {counts}\n")


def _named(words: Sequence[str]) -> str:
    rest = len(words) - _NAMED
    return ", ".join(words[:_NAMED]) + (f" and {rest} more" if rest > 0 else "")
