"""`heliarch replay`."""

# The modules that do the work are imported when it runs: `--help` does not wait for them.
# ruff: noqa: PLC0415

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from launch_scripts.commands.options import DurationOption, JsonOption

EXAMPLE: Final = "heliarch replay runs/oahu-4711 --from 13:49:00 --rate 0.5"


def replay(
    run: Annotated[
        Path, typer.Argument(help="Folder of a run, or its run.mcap.", show_default=False)
    ],
    rate: Annotated[
        float, typer.Option(help="Recorded seconds a second; 0: as fast as possible.")
    ] = 1.0,
    clock: Annotated[
        str,
        typer.Option(
            help="What spaces messages: wall (as they were published) or sim (cycles as the plant "
            "lives them).",
            metavar="CLOCK",
        ),
    ] = "wall",
    start_offset: Annotated[
        str | None,
        typer.Option(
            "--start-offset",
            "--from",
            help="First cycle: 13:49:00, 90s, or its number.",
            metavar="MOMENT",
        ),
    ] = None,
    duration: DurationOption = None,
    start_paused: Annotated[
        bool, typer.Option("--start-paused", help="Wait for the space bar.")
    ] = False,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    signals: Annotated[
        str | None,
        typer.Option(help="Only these, with commas between: impp,residual.", metavar="NAMES"),
    ] = None,
    exclude: Annotated[
        str | None, typer.Option(help="All but these; clock too may be one.", metavar="NAMES")
    ] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Begin when a subscriber is there.")] = False,
    listen: Annotated[
        str | None,
        typer.Option(
            help="Where subscribers connect: tcp/127.0.0.1:7447; default a free port.",
            metavar="ENDPOINT",
        ),
    ] = None,
    namespace: Annotated[
        str | None,
        typer.Option(help="First part of every key; default the run's own.", metavar="NAME"),
    ] = None,
    live: Annotated[
        str | None,
        typer.Option(
            help="Controllers that run live, and are compared: c1/inv01,c2.", metavar="NODES"
        ),
    ] = None,
    plan: Annotated[
        Path | None,
        typer.Option(help="Plan of the live controllers; default the run's.", metavar="FILE"),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Put a recording back onto the bus, or let some agents of it run live.

    In a terminal: space pauses and goes on, s steps one cycle, + and - change
    the rate, arrows seek (left and right 10 s, up and down 1 min of simulated
    time), q ends.
    """
    from launch_scripts.commands.replay_request import ReplayRequest
    from launch_scripts.commands.replay_work import replay as replay_work

    request = ReplayRequest(
        run,
        rate,
        clock,
        start_offset,
        duration,
        start_paused,
        loop,
        signals,
        exclude,
        wait,
        listen,
        namespace,
        live,
        plan,
        json,
    )
    raise typer.Exit(replay_work(request))
