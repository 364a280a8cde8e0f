"""The command line: `heliarch`."""

# Commands import what they need themselves: `--help` must not wait for pvlib.
# ruff: noqa: PLC0415

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from agents.plan import Actuator, Scheme

_began_at = time.monotonic()

app = typer.Typer(
    name="heliarch",
    help="Run a utility-scale solar plant's controllers as a team of processes.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

ScenarioArgument: TypeAlias = Annotated[
    str, typer.Argument(help="A shipped scenario (see `heliarch scenarios`) or a TOML file.")
]
StartOption: TypeAlias = Annotated[
    str | None,
    typer.Option(help="Local time of the first cycle: 12:30, or 2010-04-01T12:30.", metavar="TIME"),
]
DurationOption: TypeAlias = Annotated[
    str | None,
    typer.Option(help="Simulated time: seconds, or 90s, 15m, 1h30m.", metavar="TIME"),
]
PaceOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Simulated seconds per second (1 is real time), or max: lockstep.", metavar="PACE"
    ),
]
SeedOption: TypeAlias = Annotated[int | None, typer.Option(help="Seed of the synthetic clouds.")]
SchemeOption: TypeAlias = Annotated[
    Scheme | None, typer.Option(help="How maxima are estimated: as the scenario says, or this.")
]
ActuatorOption: TypeAlias = Annotated[
    Actuator | None, typer.Option(help="What inverters do with a command: fraction or limit.")
]
FaultOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        # Words of more letters than these are cut in a terminal of 80 columns.
        help="Make links imperfect: source=c1/*,delay=50ms,loss=2% (words: source, listener, "
        "signal, delay, jitter, distribution, loss, duplicate, reorder, reorder-by, "
        "silent=60s..90s). May be given several times.",
        metavar="RULE",
    ),
]
ExternalOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--external",
        help="Leave this agent out and wait for a device of your own: c2/inv07, c2, central or "
        "plant. May be given several times.",
        metavar="AGENT",
    ),
]
ExternalTimeoutOption: TypeAlias = Annotated[
    float,
    typer.Option(
        help="Seconds to wait for external agents to appear. Once all are there, they have 30 s to "
        "answer the arming rounds.",
        metavar="SECONDS",
    ),
]
BasePortOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        help="Listen on this port and those after it, under the plant's name as namespace, so "
        "that a device is set up once.",
        metavar="PORT",
    ),
]
CpusOption: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        help="Run the processes on these processors: 0-1, or plant=0 for one kind (recorder, "
        "plant, central, supervisor, direct). May be given several times.",
        metavar="CPUS",
    ),
]
PriorityOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        help="In real time: run plant and controllers under SCHED_FIFO with this priority, 1 to "
        "99, where the machine permits it.",
        metavar="PRIORITY",
    ),
]
OutOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Folder of the run; default runs/NAME-TIME.", metavar="DIR"),
]
DataOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(help="Folder of the data files that the scenario names.", metavar="DIR"),
]
ReportFlag: TypeAlias = Annotated[
    bool, typer.Option("--report", help="Write an HTML report into the run's folder.")
]
JsonOption: TypeAlias = Annotated[
    str | None,
    typer.Option("--json", help="Write the summary as JSON; - is stdout.", metavar="PATH"),
]


@app.command("launch", epilog="Example: heliarch launch oahu --start 12:30 --duration 15m")
def launch_command(
    scenario: ScenarioArgument = "oahu",
    start: StartOption = None,
    duration: DurationOption = None,
    pace: PaceOption = None,
    seed: SeedOption = None,
    scheme: SchemeOption = None,
    actuator: ActuatorOption = None,
    out: OutOption = None,
    data: DataOption = None,
    json: JsonOption = None,
    report: ReportFlag = False,
    fault: FaultOption = None,
    external: ExternalOption = None,
    external_timeout: ExternalTimeoutOption = 60.0,
    base_port: BasePortOption = None,
    cpus: CpusOption = None,
    priority: PriorityOption = None,
) -> None:
    """Run a plant as a team of processes over Zenoh, recorded.

    Starts the plant simulator, a direct controller for each inverter, the supervisors, the central
    controller and the recorder, each as a process of its own; ends them all; prints what the run
    came to.
    """
    from launch_scripts.commands.run import run
    from launch_scripts.launcher.request import RunRequest
    from launch_scripts.scenarios.externals import ExternalOptions
    from launch_scripts.scenarios.machine_table import MachineOptions

    request = RunRequest(
        "launch",
        scenario,
        start,
        duration,
        pace,
        seed,
        scheme,
        actuator,
        out,
        data,
        json,
        report,
        faults=tuple(fault or ()),
        external=ExternalOptions(tuple(external or ()), external_timeout, base_port),
        machine=MachineOptions(tuple(cpus or ()), priority),
    )
    raise typer.Exit(run(request, _began_at))


@app.command("simulate", epilog="Example: heliarch simulate valley --seed 8 --json -")
def simulate_command(
    scenario: ScenarioArgument = "oahu",
    start: StartOption = None,
    duration: DurationOption = None,
    pace: PaceOption = None,
    seed: SeedOption = None,
    scheme: SchemeOption = None,
    actuator: ActuatorOption = None,
    out: OutOption = None,
    data: DataOption = None,
    json: JsonOption = None,
    report: ReportFlag = False,
    fault: FaultOption = None,
) -> None:
    """Run the same agents in this one process: the same messages, the same recording."""
    from launch_scripts.commands.run import run
    from launch_scripts.launcher.request import RunRequest

    request = RunRequest(
        "simulate",
        scenario,
        start,
        duration,
        pace,
        seed,
        scheme,
        actuator,
        out,
        data,
        json,
        report,
        faults=tuple(fault or ()),
    )
    raise typer.Exit(run(request, _began_at))


@app.command("timing", epilog="Example: heliarch timing oahu --rate 20 --duration 60s --report")
def timing_command(
    scenario: Annotated[
        str | None,
        typer.Argument(
            help="A shipped scenario or a TOML file, default oahu (oahu-day for a study); or the "
            "folder or run.mcap of a run that was in real time: nothing is run then.",
            show_default=False,
        ),
    ] = None,
    rate: Annotated[
        str | None,
        typer.Option(
            help="Cycles a second: 20; several: 5,10,20; a range or auto: find the highest rate "
            "that the plant keeps up with. Default 1.",
            metavar="RATES",
        ),
    ] = None,
    duration: Annotated[
        str | None,
        typer.Option(
            help="Length of the run, simulated and real: seconds, or 90s, 10m; default 60s, 15s "
            "for each of several rates.",
            metavar="TIME",
        ),
    ] = None,
    start: StartOption = None,
    seed: SeedOption = None,
    scheme: SchemeOption = None,
    actuator: ActuatorOption = None,
    out: OutOption = None,
    data: DataOption = None,
    json: JsonOption = None,
    report: Annotated[
        bool, typer.Option("--report", help="Write an HTML page into the run's folder.")
    ] = False,
    processes: Annotated[
        bool, typer.Option("--processes", help="Show each process, not the tiers alone.")
    ] = False,
    fault: FaultOption = None,
    external: ExternalOption = None,
    external_timeout: ExternalTimeoutOption = 60.0,
    base_port: BasePortOption = None,
    cpus: CpusOption = None,
    priority: PriorityOption = None,
    study: Annotated[
        bool,
        typer.Option(
            "--study",
            help="In memory instead: how much delay and loss the control survives, and how slow a "
            "central controller.",
        ),
    ] = False,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="For a study: a field of the scenario.", metavar="FIELD=VALUE"),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="For a study: processes that share it; default 2.")
    ] = None,
) -> None:
    """Run a plant in real time and report whether every tier meets its deadlines, and by how much.

    With a recorded run instead of a scenario, report on that.

    Exit status 1: a budget was not kept, or the run failed. A scenario states its own budgets in
    its table timing.budgets; see docs/timing.md.
    """
    from launch_scripts.commands.timing import TimingRequest, timing
    from launch_scripts.launcher.request import RunRequest
    from launch_scripts.scenarios.externals import ExternalOptions
    from launch_scripts.scenarios.machine_table import MachineOptions

    run = RunRequest(
        "launch",
        scenario or "oahu",
        start,
        None,
        None,
        seed,
        scheme,
        actuator,
        out,
        data,
        json,
        report=False,
        faults=tuple(fault or ()),
        external=ExternalOptions(tuple(external or ()), external_timeout, base_port),
        machine=MachineOptions(tuple(cpus or ()), priority),
    )
    request = TimingRequest(
        run, scenario, rate, duration, processes, report, study, tuple(settings or ()), workers
    )
    raise typer.Exit(timing(request))


@app.command("report", epilog="Example: heliarch report runs/oahu-20261121-120000-4711")
def report_command(
    run: Annotated[
        Path, typer.Argument(help="Folder of a run, or its run.mcap.", show_default=False)
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="The HTML file; default report.html in the run's folder.", metavar="FILE"
        ),
    ] = None,
) -> None:
    """Write the figures and tables of a run as one HTML page, which opens without a network."""
    from launch_scripts.commands.report import report

    raise typer.Exit(report(run, out))


@app.command(
    "compare",
    epilog="Example: heliarch compare oahu --set commitment.share=0.3,0.45 --seeds 1..10",
)
def compare_command(
    scenario: ScenarioArgument = "oahu-day",
    start: StartOption = None,
    duration: DurationOption = None,
    days: Annotated[
        str | None,
        typer.Option(help="Dates, such as 2010-04-01..2010-04-30.", metavar="DATES"),
    ] = None,
    seeds: Annotated[
        str | None, typer.Option(help="Seeds of synthetic clouds, such as 1..5,9.", metavar="SEEDS")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="A field of the scenario and its values; each combination is a case.",
            metavar="FIELD=VALUES",
        ),
    ] = None,
    schemes: Annotated[
        str | None, typer.Option(help="Control schemes, with commas between.", metavar="NAMES")
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option(
            help="Reference groups of grouping control: sizes (1,4,8), or inverters (inv01,inv07).",
            metavar="GROUPS",
        ),
    ] = None,
    show: Annotated[
        str, typer.Option(help="Figure to show of many cases.", metavar="FIGURE")
    ] = "control-caused",
    workers: Annotated[int, typer.Option(help="Processes that share the cases.")] = 1,
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler that shares the cases.", metavar="ADDRESS")
    ] = None,
    data: DataOption = None,
    report: Annotated[
        Path | None, typer.Option(help="Write an HTML report of one case.", metavar="FILE")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Put control schemes side by side: the paper's tables, for any day or for many."""
    from launch_scripts.commands.compare import CompareRequest, compare

    request = CompareRequest(
        scenario,
        start,
        duration,
        days,
        seeds,
        settings or [],
        schemes,
        reference,
        show,
        workers,
        scheduler,
        data,
        report,
        json,
    )
    raise typer.Exit(compare(request))


@app.command("clusters", epilog="Example: heliarch clusters oahu --random 50 --periods 1,30")
def clusters_command(
    scenario: ScenarioArgument = "oahu",
    start: StartOption = None,
    duration: DurationOption = None,
    periods: Annotated[
        str | None,
        typer.Option(
            help="How often the central controller acts, seconds; default 1,10,60 as the cycle "
            "allows.",
            metavar="SECONDS",
        ),
    ] = None,
    random: Annotated[int, typer.Option(help="How many random choices of clusters to try.")] = 20,
    scheme: SchemeOption = None,
    learn: Annotated[
        str | None,
        typer.Option(
            help="Choose clusters from the first part of the run, as long as this, run the rest.",
            metavar="TIME",
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="A field of the scenario and its value.", metavar="FIELD=VALUE"),
    ] = None,
    data: DataOption = None,
    json: JsonOption = None,
) -> None:
    """Show what virtual neighbours are worth beside geographic and random clusters."""
    from launch_scripts.commands.clusters import ClustersRequest, clusters

    request = ClustersRequest(
        scenario, start, duration, periods, random, scheme, learn, settings or [], data, json
    )
    raise typer.Exit(clusters(request))


@app.command("export", epilog="Example: heliarch export runs/oahu-20261121-120000-4711 --to csv")
def export_command(
    run: Annotated[
        Path, typer.Argument(help="Folder of a run, or its run.mcap.", show_default=False)
    ],
    to: Annotated[
        str,
        typer.Option(
            help="json-mcap (for Foxglove and Lichtblick), parquet or csv.",
            metavar="FORM",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="The file, or folder of tables, to make; default beside the recording.",
            metavar="PATH",
        ),
    ] = None,
    signals: Annotated[
        str | None,
        typer.Option(help="Only these, with commas between: impp,residual.", metavar="NAMES"),
    ] = None,
    nodes: Annotated[
        str | None,
        typer.Option(help="Only about these: c2/inv07,c2,central.", metavar="NODES"),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option("--from", help="First cycle: 13:49:00, 90s, or its number.", metavar="MOMENT"),
    ] = None,
    end: Annotated[
        str | None,
        typer.Option("--until", help="Last cycle, likewise.", metavar="MOMENT"),
    ] = None,
    clock: Annotated[
        str | None,
        typer.Option(
            help="Times that a viewer shows: wall (as recorded) or sim (those of the plant).",
            metavar="CLOCK",
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Make a file for viewers, or tidy tables, of a recording."""
    from launch_scripts.commands.export import ExportRequest, run_export

    request = ExportRequest(run, to, out, signals, nodes, start, end, clock, json)
    raise typer.Exit(run_export(request))


@app.command(
    "verify",
    epilog="Example: heliarch verify runs/oahu-20261121-120000-4711 --node 'c2/*'",
)
def verify_command(
    runs: Annotated[
        list[Path],
        typer.Argument(
            help="Folders of runs, or their run.mcap.", metavar="RUN...", show_default=False
        ),
    ],
    nodes: Annotated[
        list[str] | None,
        typer.Option(
            "--node",
            help="Agents to re-run: plant, central, c2, c2/inv07; c2/*: c2 and all below it.",
            metavar="NAMES",
        ),
    ] = None,
    tolerance: Annotated[
        float, typer.Option(help="Largest difference of two equal floats.", metavar="X")
    ] = 0.0,
    ignored: Annotated[
        list[str] | None,
        typer.Option("--ignore", help="Fields that may differ.", metavar="FIELDS"),
    ] = None,
    accept: Annotated[
        bool,
        typer.Option("--accept", help="Replace the recording by what the agents do now."),
    ] = False,
    json: JsonOption = None,
) -> None:
    """Re-run the agents of a recording on the inputs that they used, and compare what they say.

    Exit status 1: they differ, each agent's first difference is shown with its inputs; or what was
    lost leaves it undecided.
    """
    from launch_scripts.commands.verify import VerifyRequest, run_verify

    request = VerifyRequest(runs, nodes or [], tolerance, ignored or [], accept, json)
    raise typer.Exit(run_verify(request))


@app.command("replay", epilog="Example: heliarch replay runs/oahu-4711 --from 13:49:00 --rate 0.5")
def replay_command(
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
    from launch_scripts.commands.replay import replay
    from launch_scripts.commands.replay_request import ReplayRequest

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
    raise typer.Exit(replay(request))


@app.command(
    "inspect",
    epilog="Example: heliarch inspect RUN --node c2/inv07 --from 13:49:00 --to 13:50:30",
)
def inspect_command(
    run: Annotated[
        Path, typer.Argument(help="Folder of a run, or its run.mcap.", show_default=False)
    ],
    node: Annotated[
        str | None,
        typer.Option(
            help="Tell this node's story, cycle by cycle: c2/inv07, c1 or central.", metavar="NODE"
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option("--from", help="First cycle: 13:49:00, 90s, or its number.", metavar="MOMENT"),
    ] = None,
    end: Annotated[
        str | None,
        typer.Option("--to", help="Last cycle, likewise.", metavar="MOMENT"),
    ] = None,
    cycle: Annotated[
        str | None,
        typer.Option(help="Show the whole plant in one cycle, likewise.", metavar="MOMENT"),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Show what a recording holds, one node's story, or the whole plant in one cycle.

    Without --node and --cycle: scenario, duration, versions, messages and
    rate of each signal, and what is missing in between.
    """
    from launch_scripts.commands.inspect import InspectRequest, inspect

    raise typer.Exit(inspect(InspectRequest(run, node, start, end, cycle, json)))


@app.command("recover", epilog="Example: heliarch recover RUN --out whole.mcap")
def recover_command(
    run: Annotated[
        Path, typer.Argument(help="Folder of a run, or its run.mcap.", show_default=False)
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="The new file; default run.recovered.mcap beside the recording.", metavar="FILE"
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Make a whole recording of one that a crash or a full disk has cut.

    Exit status: 0 if nothing is missing, 3 if something is or may be,
    1 if there is nothing to recover.
    """
    from launch_scripts.commands.recover import recover

    raise typer.Exit(recover(run, out, json))


@app.command("scenarios", epilog="Example: heliarch scenarios")
def scenarios_command() -> None:
    """List the scenarios that come with Heliarch."""
    from launch_scripts.scenarios.scenario import load_scenario, shipped_scenarios

    for name in shipped_scenarios():
        typer.echo(f"{name:14} {load_scenario(name).scenario.title}")


def main() -> None:
    """Run the command line. Ctrl-C while a command is still being loaded ends it in one line."""
    try:
        app()
    except KeyboardInterrupt:
        sys.stderr.write("heliarch: interrupted\n")
        sys.exit(130)
