"""`heliarch replay --live`: the named controllers as processes, and what they say compared."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TextIO

import msgspec

from agents.plan import RunPlan, load_plan
from bus_schemas.errors import InputError
from bus_schemas.tree import agent_name
from launch_scripts.interruption import Interruption, interruptible
from launch_scripts.processes import processes
from launch_scripts.replay.arming import arm
from launch_scripts.replay.figures import TimingFigures, print_timing, timing_figures, write_json
from launch_scripts.replay.live import LiveReplay
from launch_scripts.replay.output_comparison import OutputDifference
from launch_scripts.replay.progress import ProgressLine
from launch_scripts.replay.request import ReplayRequest, before_cycle
from launch_scripts.replay.selection import select
from launch_scripts.replay.session import await_subscriber, introduce, replay_session
from launch_scripts.replay.stand_in import StandIn, live_plan
from launch_scripts.replay.tape import Tape
from launch_scripts.supervision import Children, RunFailure
from launch_scripts.tcp_ports import reserved_ports
from recordings.moments import RunClock
from recordings.selection import find_nodes

EQUAL: Final = 0
DIFFERENT: Final = 1
INTERRUPTED: Final = 130

_SHOWN: Final = 20
"""So many differences are printed."""

_NAMED: Final = 5
"""So many controllers are named before the rest is counted."""

_WIDTH: Final = 100

_STAND_IN: Final = "stand-in"
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


class LiveFigures(msgspec.Struct, frozen=True):
    """What a live replay came to.

    Attributes
    ----------
    compared
        Pairs of messages, new and recorded, of the live controllers.
    differing
        Messages that differ or lack their counterpart, by controller.
    differences
        The first of them, field by field.
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
    differences: list[OutputDifference]
    timing_error: TimingFigures | None
    interrupted: bool


def replay_live(request: ReplayRequest, tape: Tape, out: TextIO) -> int:
    """Replay with live controllers, and say in what they differ. Returns the exit status.

    Raises
    ------
    InputError
        A name that is no controller of the run, or a plan of another plant.
    RunFailure
        A live controller died, gave up, or says nothing any more.
    """
    live = _live_agents(tape.plan, request.live or "")
    plan = _plan(request, tape)
    introduce(tape, out)
    out.write(f"live: {_named(live)}; all others do as recorded, whatever these say\n")
    with interruptible() as interruption, _folder() as folder:
        began_at = time.monotonic()
        replay = _run(request, tape, plan, live, folder, interruption, out)
        wall_s = time.monotonic() - began_at
    figures = LiveFigures(
        plan.run_id,
        str(tape.path),
        list(live),
        replay.cycles,
        wall_s,
        replay.comparison.compared,
        dict(replay.comparison.differing),
        replay.comparison.differences,
        timing_figures(replay.timing),
        bool(interruption),
    )
    _print(figures, plan, out)
    write_json(figures, request.json)
    if interruption:
        return INTERRUPTED
    return DIFFERENT if figures.differing else EQUAL


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
    request: ReplayRequest,
    tape: Tape,
    plan: RunPlan,
    live: Sequence[str],
    folder: Path,
    interruption: Interruption,
    out: TextIO,
) -> LiveReplay:
    selection = select(plan)
    with reserved_ports((_STAND_IN, *live)) as tcp_ports:
        told = live_plan(plan, live, tcp_ports, tcp_ports[_STAND_IN])
        plan_path = folder / "plan.json"
        plan_path.write_bytes(told.as_json())
        specs = [spec for spec in processes(plan.tree, plan_path) if spec.agent in live]
        with (
            replay_session(tape, selection, request.namespace, request.listen, out) as observers,
            StandIn(told, live, tcp_ports[_STAND_IN]) as stand_in,
            Children(specs, folder) as children,
        ):
            arm(tape, told, live, stand_in, children, interruption)
            if request.wait:
                await_subscriber(observers, interruption, out)
            progress = ProgressLine(out, plan)
            replay = LiveReplay(
                tape, told, live, children, stand_in, observers, interruption, progress
            )
            replay.run()
            progress.close()
    return replay


def _live_agents(plan: RunPlan, text: str) -> tuple[str, ...]:
    names = dict.fromkeys(name.strip() for name in text.split(","))
    try:
        return tuple(agent_name(node) for node in find_nodes(plan.tree, names))
    except InputError as error:
        raise InputError(f"--live: {error}") from None


def _plan(request: ReplayRequest, tape: Tape) -> RunPlan:
    """Return the plan that the live controllers run by, with the cycles to replay."""
    cycles = before_cycle(request.duration, tape, 0) or tape.complete_cycles
    if not cycles:
        raise InputError(f"{tape.path}: no complete cycle, accepted is a run that has one")
    plan = tape.plan
    if request.plan is not None:
        plan = load_plan(request.plan)
        for field in _SHARED:
            found, recorded = getattr(plan, field), getattr(tape.plan, field)
            if found != recorded:
                raise InputError(
                    f"{request.plan}: {field} is {_brief(found)}, accepted is that of the recorded "
                    f"run, {_brief(recorded)}"
                )
    return msgspec.structs.replace(
        plan, run_id=tape.plan.run_id, cycles=min(cycles, tape.complete_cycles)
    )


def _brief(value: object) -> str:
    text = str(value)
    return text if len(text) <= 40 else f"{text[:40]}..."


def _print(figures: LiveFigures, plan: RunPlan, out: TextIO) -> None:
    out.write(
        f"compared {figures.compared:,} messages of {len(figures.live)} live controllers over "
        f"{figures.cycles:,} cycles in {figures.wall_s:.1f} s\n"
    )
    print_timing(figures.timing_error, out)
    if not figures.differing:
        out.write("no difference\n")
        return
    clock = RunClock(plan, figures.cycles - 1)
    for difference in figures.differences[:_SHOWN]:
        out.write(f"{_line(difference, clock)}\n")
    most_first = sorted(figures.differing.items(), key=lambda entry: (-entry[1], entry[0]))
    counts = _named([f"{agent} {count:,}" for agent, count in most_first])
    out.write(f"messages that differ: {counts}\n")


def _line(difference: OutputDifference, clock: RunClock) -> str:
    about_itself = difference.key.startswith(f"{difference.agent}/")
    key = difference.key.removeprefix(f"{difference.agent}/") if about_itself else difference.key
    where = f"{difference.agent}, cycle {difference.cycle} ({clock.text(difference.cycle)}), {key}"
    if difference.kind == "other inputs":
        lacked, lacks = len(difference.recorded), len(difference.new)
        return (
            f"{where}: other inputs, {lacked} were late or missing when recorded, {lacks} are now"
        )
    if difference.kind != "differs":
        return f"{where}: {difference.kind}"
    where, recorded, new = f"{where} {difference.field}", difference.recorded, difference.new
    line = f"{where}: recorded {recorded!r}, new {new!r}"
    return line if len(line) <= _WIDTH else f"{where}\n  recorded {recorded!r}\n  new      {new!r}"


def _named(words: Sequence[str]) -> str:
    rest = len(words) - _NAMED
    return ", ".join(words[:_NAMED]) + (f" and {rest} more" if rest > 0 else "")
