"""`heliarch replay`: a recording back on the bus, with or without live controllers."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Literal

import typer

from bus_schemas.errors import InputError
from launch_scripts.commands.boundary import FAILED, INTERRUPTED, OK
from launch_scripts.commands.options import refuse_others
from launch_scripts.commands.output import write_json


def replay(
    context: typer.Context,
    run: Path,
    start: str | None = None,
    end: str | None = None,
    pace: str = "1",
    clock: Literal["sim", "wall"] | None = None,
    start_paused: bool = False,
    loop: bool = False,
    nodes: str | None = None,
    signals: str | None = None,
    exclude: str | None = None,
    wait: bool = False,
    listen: str | None = None,
    live: str | None = None,
    plan: Path | None = None,
    json: str | None = None,
) -> int:
    """Put a recording back onto the bus, or let some agents of it run live.

    In a terminal: space pauses and goes on, s steps one cycle, + and - change
    the pace, arrows seek (left and right 10 s, up and down 1 min of simulated
    time), q ends.

    --pace PACE: Recorded seconds per second, or max.
    --clock: sim: each cycle when it begins in simulated time (default after lockstep); wall: each
        message when it was published (default after real time).
    --start-paused: Wait for the space bar.
    --loop: Begin again at the end.
    --exclude NAMES: Leave these signals out; clock is the replay's own clock.
    --wait: Begin when somebody subscribes.
    --listen ENDPOINT: Where subscribers connect: tcp/127.0.0.1:7447; default a free port.
    --live NODES: Controllers to run live and to compare: c1/inv01,c2.
    --plan FILE: Plan of the live controllers; default the run's.
    Example: heliarch replay runs/oahu-4711 --from 13:49:00 --pace 0.5
    """
    from launch_scripts.scenarios.real_time import parse_pace
    from recordings.read.reader import RunReader
    from recordings.replay.bus import selected_ports
    from recordings.replay.keyboard import has_keyboard
    from recordings.replay.live_run import replay_live
    from recordings.replay.playback import replay_recording

    out = sys.stderr if json == "-" else sys.stdout
    if live is None and plan is not None:
        raise InputError("--plan: expected --live with it: the live controllers run by this plan")
    if start_paused and not has_keyboard():
        raise InputError("--start-paused: expected a terminal, where space goes on")
    if live is not None:
        allowed = ("run", "end", "wait", "listen", "live", "plan", "json")
        refuse_others(context, allowed, "not possible with --live, which begins with the run")
        with RunReader(run) as reader:
            found = replay_live(
                reader, out, live, plan_file=plan, end=end, wait=wait, listen=listen
            )
        write_json(found, json)
        return INTERRUPTED if found["interrupted"] else FAILED if found["differing"] else OK
    speed = parse_pace(pace)
    with RunReader(run) as reader:
        figures = replay_recording(
            reader,
            out,
            selected_ports(reader, signals, exclude, nodes),
            start=start,
            end=end,
            rate=speed if isinstance(speed, float) else 0.0,
            clock=clock,
            start_paused=start_paused,
            loop=loop,
            wait=wait,
            listen=listen,
        )
    write_json(figures, json)
    return INTERRUPTED if figures["interrupted"] else OK
