"""Replay with live controllers: the named controllers as processes, and their messages compared."""

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
from launch_scripts.launcher.fork_requests import Start
from launch_scripts.launcher.interruption import Interruption, interruptible
from launch_scripts.launcher.supervision import Children, ForkServerProcess, RunFailure
from launch_scripts.launcher.tcp_ports import reserved_ports
from recordings.read.moments import RunClock
from recordings.read.reader import RunReader
from recordings.read.selection import find_nodes
from recordings.replay.bus import await_subscriber, replay_bus, say, selected_ports
from recordings.replay.live import LiveReplay
from recordings.replay.live_bus import LiveBus, live_plan
from recordings.replay.progress import ProgressLine
from recordings.replay.publish_order import complete_cycles
from recordings.replay.timing import TimingFigures
from recordings.verify.report import finding_data, finding_lines, json_ready

_OTHERS: Final = "others"
_SHARED: Final = (
    "plant",
    "inverters",
    "start_time_ns",
    "cycle_ns",
    "cycle_wall_ns",
    "period_cycles",
)
"""Fields in which the plan of the live controllers must be that of the recorded run."""


@dataclass(frozen=True, slots=True)
class LiveRequest:
    """What runs live, and how: values of the options of `heliarch replay`."""

    live: str
    plan: Path | None = None
    end: str | None = None
    wait: bool = False
    listen: str | None = None


class LiveFigures(msgspec.Struct, frozen=True):
    """The result of a live replay; `agents` as `heliarch verify --json` has them."""

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


def replay_live(request: LiveRequest, reader: RunReader, out: TextIO) -> LiveFigures:
    """Replay with live controllers, and print in what they differ."""
    live = _live_agents(reader.plan, request.live)
    plan = _plan(request, reader)
    with interruptible() as interruption, _folder() as folder:
        began_at = time.monotonic()
        replay = _run(request, reader, plan, live, folder, interruption, out)
        wall_s = time.monotonic() - began_at
    findings = replay.comparison.findings
    figures = LiveFigures(
        plan.run_id,
        str(reader.path),
        list(live),
        replay.cycles,
        wall_s,
        sum(found.compared for found in findings.values()),
        {name: sum(found.differences.values()) for name, found in findings.items() if found.first},
        [json_ready(finding_data(name, found)) for name, found in findings.items()],
        replay.timing.figures(),
        bool(interruption),
    )
    say(
        out,
        f"compared {figures.compared:,} messages of {len(live)} live controllers over "
        f"{figures.cycles:,} cycles in {wall_s:.1f} s",
    )
    if figures.timing_error is not None:
        figures.timing_error.write(out)
    clock = RunClock(plan, replay.cycles - 1)
    for name, found in findings.items():
        for line in finding_lines(name, found, clock):
            say(out, line)
    counts = [f"{agent} {count:,}" for agent, count in figures.differing.items()]
    say(out, f"differences: {', '.join(counts) or 'none'}")
    return figures


@contextmanager
def _folder() -> Iterator[Path]:
    """Make a folder for plan and logs. If the replay fails, it is kept and named."""
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
    reader: RunReader,
    plan: RunPlan,
    live: Sequence[str],
    folder: Path,
    interruption: Interruption,
    out: TextIO,
) -> LiveReplay:
    with (
        ForkServerProcess() as server,
        reserved_ports((_OTHERS, *live)) as tcp_ports,
        Children(server, plan, live, folder) as children,
    ):
        plan = live_plan(plan, live, tcp_ports, tcp_ports[_OTHERS])
        path = folder / "plan.json"
        path.write_bytes(plan.as_json())
        with (
            replay_bus(reader, selected_ports(plan), request.listen, out) as observers,
            LiveBus(plan, live, tcp_ports[_OTHERS]) as bus,
        ):
            say(out, f"live: {', '.join(live)}; all others as recorded")
            server.ask(Start(str(path), tuple(live), str(folder), 0.0))
            progress = ProgressLine(out, reader.clock, plan.cycles - 1)
            replay = LiveReplay(
                reader, plan, live, children, bus, observers, interruption, progress
            )
            replay.arm()
            if request.wait:
                await_subscriber(observers, interruption, out)
            replay.run()
    return replay


def _live_agents(plan: RunPlan, text: str) -> tuple[str, ...]:
    names = dict.fromkeys(name.strip() for name in text.split(","))
    try:
        return tuple(agent_name(node) for node in find_nodes(plan.tree, names))
    except InputError as error:
        raise InputError(f"--live: {error}") from None


def _plan(request: LiveRequest, reader: RunReader) -> RunPlan:
    """Return the plan of the live controllers, with the cycles to replay."""
    complete = complete_cycles(reader)
    if not complete:
        raise InputError(f"{reader.path}: expected a complete cycle, got none")
    plan = reader.plan
    if request.plan is not None:
        plan = load_plan(request.plan)
        for field in _SHARED:
            found, wanted = getattr(plan, field), getattr(reader.plan, field)
            if found != wanted:
                raise InputError(
                    f"{request.plan} {field}: expected {_brief(wanted)}, as in the recorded run, "
                    f"got {_brief(found)}"
                )
    cycles = min(reader.clock.span(None, request.end).stop, complete)
    return msgspec.structs.replace(plan, run_id=reader.plan.run_id, cycles=cycles)


def _brief(value: object) -> str:
    text = str(value)
    return text if len(text) <= 40 else f"{text[:40]}..."
