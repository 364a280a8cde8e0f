"""Replay with live controllers: the named controllers as processes, and their messages compared."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, TextIO

import msgspec

from agents.plan import RunPlan, changed, load_plan
from agents.process.events import Start
from agents.process.interruption import interruptible
from agents.process.machine import MachineSettings
from bus_schemas.errors import InputError, listed
from bus_schemas.selection import find_nodes
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import agent_name
from launch_scripts.supervision import Children, ForkServerProcess, RunFailure
from recordings.read.reader import RunReader
from recordings.read.run_clock import RunClock
from recordings.replay.bus import await_subscriber, replay_bus, say, selected_ports
from recordings.replay.keyboard import no_keyboard
from recordings.replay.playback import Playback, StatusLine
from recordings.replay.schedule import PlaybackClock
from recordings.verify.report import agents_data, difference_lines
from studies.live_replay.live_bus import LiveBus

_OTHERS: Final = "others"
_SHARED: Final = (
    *("plant", "inverters", "timing.start_time_ns"),
    *("timing.cycle_ns", "timing.cycle_wall_ns", "control.period_cycles"),
)
"""Fields in which the plan of the live controllers must be that of the recorded run."""


def replay_live(
    reader: RunReader,
    out: TextIO,
    line: StatusLine,
    live_nodes: str,
    *,
    plan_file: Path | None,
    end: str | None,
    wait: bool,
    listen: str | None,
) -> dict[str, Any]:
    """Replay with live controllers, and print in what they differ; return the figures for JSON.

    The arguments are the options of `heliarch replay`.
    """
    live = tuple(map(agent_name, find_nodes(reader.plan.tree, live_nodes, "--live")))
    plan = _plan(reader, plan_file, end)
    began_at = time.monotonic()
    with (
        interruptible() as interruption,
        _folder() as folder,
        ForkServerProcess() as server,
        reserved_ports((_OTHERS, *live)) as tcp_ports,
        Children(server, plan, live, folder) as children,
    ):
        path = folder / "plan.json"
        its_plan = _live_plan(plan, tcp_ports)
        path.write_bytes(its_plan.as_json())
        with (
            replay_bus(reader, selected_ports(reader), listen, out) as observers,
            LiveBus(its_plan, tcp_ports[_OTHERS], observers, children, interruption) as bus,
        ):
            say(out, f"live: {', '.join(live)}; all others as recorded")
            server.ask(Start(str(path), tuple(live), str(folder)))
            clock = PlaybackClock(0.0 if plan.timing.lockstep else 1.0, sleep=bus.listen)
            span = range(plan.timing.cycles)
            playback = Playback(
                reader, reader.ports(), span, bus, clock, no_keyboard, interruption, line
            )
            bus.arm(reader)
            if wait:
                await_subscriber(observers, interruption, out)
            playback.play()
            bus.finish()
    wall_s = time.monotonic() - began_at
    results = bus.pairs.results
    compared = sum(result.compared for result in results.values())
    differing = {name: one.differences.total() for name, one in results.items() if one.first}
    say(out, f"compared {compared:,} messages over {bus.cycles:,} cycles in {wall_s:.1f} s")
    of_run = RunClock(plan, bus.cycles - 1)
    for text in difference_lines(results, of_run):
        say(out, text)
    replaced = {agent: sorted(cycles) for agent, cycles in bus.pairs.replaced.items()}
    for agent, cycles in replaced.items():
        when = listed([of_run.span_text(cycle, cycle) for cycle in cycles], 3)
        say(out, f"{agent}: in the run a new process replaced it {when}; the live one went on")
    say(out, f"differences: {sum(differing.values()):,}")
    return {
        "run_id": plan.run_id,
        "recording": str(reader.path),
        "live": live,
        "cycles": bus.cycles,
        "wall_s": wall_s,
        "compared": compared,
        "differing": differing,
        "replaced": replaced,
        "agents": agents_data(results),
        "interrupted": bool(interruption),
    }


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


def _live_plan(plan: RunPlan, tcp_ports: dict[str, int]) -> RunPlan:
    """Return the plan by which live controllers find each other, and all others at one TCP port."""
    ports = {agent: tcp_ports.get(agent, tcp_ports[_OTHERS]) for agent in plan.links.listening}
    access = {"tcp_ports": ports, "namespace": "", "external": (), "address": "127.0.0.1"}
    return changed(
        plan.public,
        access=access | {"addresses": {}},
        faults={"rules": (), "device": ()},
        supervision={"machine": MachineSettings()},
    )


def _plan(reader: RunReader, file: Path | None, end: str | None) -> RunPlan:
    """Return the plan of the live controllers, with the cycles to replay."""
    complete = reader.last_cycle + 1
    if reader.stop_cycle is None:  # The run or the recording broke off.
        complete = max(reader.last_cycle - reader.plan.control.periods.longest, 0)
    if not complete:
        raise InputError(f"{reader.path}: expected a complete cycle, got none")
    plan = reader.plan
    if file is not None:
        plan = load_plan(file)
        for field in _SHARED:
            value_of = attrgetter(field)
            if value_of(plan) != value_of(reader.plan):
                raise InputError(f"{file} {field}: expected that of the recorded run")
    cycles = min(reader.clock.span(None, end).stop, complete)
    # Live controllers are named one by one, and each has a process of its own.
    plan = changed(plan, timing={"cycles": cycles}, supervision={"groups": ()})
    return msgspec.structs.replace(plan, run_id=reader.plan.run_id)
