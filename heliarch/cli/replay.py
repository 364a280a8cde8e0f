"""`heliarch replay`: a recording back on the bus, with or without live controllers."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter

from bus_schemas.errors import InputError
from heliarch.cli.boundary import FAILED, INTERRUPTED, OK
from heliarch.cli.options import End, Given, Json, Nodes, Run, Signals, Start, refuse_others
from heliarch.cli.output import Output

_LIVE: Final = {"--live", "--plan", "--to", "--wait", "--listen", "--json"}


def replay(
    run: Run,
    /,
    *,
    start: Start = None,
    end: End = None,
    pace: Annotated[str, Parameter(metavar="PACE")] = "1",
    start_paused: bool = False,
    loop: bool = False,
    nodes: Nodes = None,
    signals: Signals = None,
    wait: bool = False,
    listen: Annotated[str | None, Parameter(metavar="ENDPOINT")] = None,
    live: Annotated[str | None, Parameter(metavar="NODES")] = None,
    plan: Annotated[Path | None, Parameter(metavar="FILE")] = None,
    json: Json = None,
    given: Given = frozenset(),
) -> int:
    """Put a recording back onto the bus, or let some agents of it run live.

    In a terminal: space pauses and continues, q ends.

    Example: `heliarch replay runs/oahu-4711 --from 13:49:00 --pace 0.5`

    Parameters
    ----------
    pace
        Recorded seconds per second, or max.
    start_paused
        Wait for the space bar.
    loop
        Begin again at the end.
    wait
        Begin when somebody subscribes.
    listen
        Where subscribers connect: tcp/127.0.0.1:7447; default a free port.
    live
        Controllers to run live and to compare: c1/inv01,c2.
    plan
        Plan of the live controllers; default the run's.
    """
    from heliarch.cli.live_view import StatusLine
    from recordings.read.reader import RunReader
    from recordings.replay.bus import selected_ports
    from recordings.replay.keyboard import has_keyboard
    from recordings.replay.playback import ReplayOptions, replay_recording
    from scenarios.real_time import parse_pace
    from studies.live_replay import replay_live

    out = sys.stderr if json == "-" else sys.stdout
    if live is None and plan is not None:
        raise InputError("--plan: expected --live with it: the live controllers run by this plan")
    if live is not None:
        refuse_others(given, _LIVE, "expected no --live, which begins with the run")
    if start_paused and not has_keyboard():
        raise InputError("--start-paused: expected a terminal, in which space continues")
    line, speed = StatusLine(out, in_place=out.isatty()), parse_pace(pace)
    with RunReader(run) as reader:
        if live is not None:
            found = replay_live(
                reader, out, line, live, plan_file=plan, end=end, wait=wait, listen=listen
            )
        else:
            rate = speed if isinstance(speed, float) else 0.0
            options = ReplayOptions(start, end, rate, start_paused, loop, wait, listen)
            ports = selected_ports(reader, signals, nodes)
            found = replay_recording(reader, out, line, ports, options)
    Output(json).write(found)
    return INTERRUPTED if found["interrupted"] else FAILED if found.get("differing") else OK
