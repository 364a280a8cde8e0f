"""`heliarch replay`: a recording back on the bus, whole or without some of its agents."""

from __future__ import annotations

import sys
from typing import Annotated, Final

from cyclopts import Parameter

from heliarch.cli.boundary import INTERRUPTED, OK
from heliarch.cli.options import End, Given, Json, Nodes, Run, Signals, Start, refuse_others
from heliarch.cli.output import Output

_PROCESS: Final = "launch_scripts.process"
_WITH_WITHOUT: Final = {"--without", "--to", "--pace", "--listen", "--json"}


def replay(
    run: Run,
    /,
    *,
    start: Start = None,
    end: End = None,
    pace: Annotated[str, Parameter(metavar="PACE")] = "1",
    loop: bool = False,
    nodes: Nodes = None,
    signals: Signals = None,
    wait: bool = False,
    listen: Annotated[str | None, Parameter(metavar="ENDPOINT")] = None,
    without: Annotated[str | None, Parameter(metavar="NODES")] = None,
    json: Json = None,
    given: Given = frozenset(),
) -> int:
    """Put a recording back onto the bus, whole or without some agents.

    With --without it prints the command that starts an agent beside the replay, also under pdb,
    and begins when all agents that are left out answer.

    Example: `heliarch replay runs/oahu-4711 --from 13:49:00 --pace 0.5`

    Parameters
    ----------
    pace
        Recorded seconds per second, or max.
    loop
        Begin again at the end.
    wait
        Begin when somebody subscribes.
    listen
        Where subscribers connect: tcp/127.0.0.1:7447; default a free port.
    without
        Controllers whose messages are left out, to run them yourself: c1/inv01,c2.
    """
    from heliarch.cli.live_view import StatusLine
    from recordings.read.reader import RunReader
    from recordings.replay.bus import ReplayOptions, selected_ports
    from recordings.replay.playback import replay_recording
    from scenarios.real_time import parse_pace

    out = sys.stderr if json == "-" else sys.stdout
    if without is not None:
        refuse_others(given, _WITH_WITHOUT, "expected no --without, which replays the whole run")
    line, speed = StatusLine(out, in_place=out.isatty()), parse_pace(pace)
    with RunReader(run) as reader:
        rate = speed if isinstance(speed, float) else 0.0
        options = ReplayOptions(start, end, rate, loop, wait, listen, without, _PROCESS)
        ports = selected_ports(reader, signals, nodes)
        found = replay_recording(reader, out, line, ports, options)
    Output(json).write(found)
    return INTERRUPTED if found["interrupted"] else OK
