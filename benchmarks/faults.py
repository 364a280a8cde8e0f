"""What the death, the standstill and the isolation of each kind of controller cost.

`python benchmarks/faults.py` simulates six parts of the hour and takes the worst of each figure;
`--real` runs real processes at the pace of the clock, two minutes for each row. `--standby` gives
every parent a standby. `--only central,c2` chooses rows.

One fault comes 30.7 s after the first cycle, so that what takes half a second costs a cycle. All
figures are taken from the recording, beside that of a simulated run without a fault:

noticed     until the first message that goes without an input of the stopped controller
normal      until no message from or for it lacks an input, and power is within 1 % of the rating of
            the run without a fault, for good; "-": it never left that state
over        most power, and energy, above what was desired, or given without a fault
under       most power, and energy, below both
missing     messages that were not sent, and those that were lost on their way
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from fnmatch import fnmatchcase
from itertools import repeat
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import harness
import numpy as np
from rich.console import Console

import heliarch
from bus_schemas.messages import Run
from bus_schemas.missing import parse_missing
from recordings import open_run
from recordings.read.run_file import RECORDING_NAME
from recordings.read.series import RunSeries, read_plant_series
from studies.tables import Cell, Column, Table, key_column, print_table

AT_S: Final = 30.7
LENGTH: Final = "120s"
NEAR_SHARE: Final = 0.01
VICTIMS: Final = {
    "central": "central controller",
    "c2": "supervisor",
    "c2/inv07": "direct controller",
    "*": "all controllers",
}
FAULTS: Final = {
    "kill": "kill={},at=30.7s",
    "freeze 3 s": "freeze={},at=30.7s..33.7s",
    "freeze 15 s": "freeze={},at=30.7s..45.7s",
    "cut off 30 s": "partition={}|*,at=30.7s..60.7s",
}
STARTS: Final = ("12:00", "12:10", "12:20", "12:30", "12:40", "12:50")


class Recorded(NamedTuple):
    """What the figures rest on.

    plant: Its powers, shape (cycles,).
    sent: Key and cycle of each message that comes in every cycle; `lost`: how many were lost.
    lacking: Inputs that messages go without: time [s], cycle, publisher, who lacks it.
    """

    plant: RunSeries
    sent: set[tuple[str, int]]
    lacking: list[tuple[float, int, str, str]]
    lost: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--real", action="store_true")
    parser.add_argument("--standby", action="store_true")
    parser.add_argument("--scenario", default="oahu")
    parser.add_argument("--only", default=",".join(VICTIMS))
    words = parser.parse_args()
    standby = '["central","supervisors"]' if words.standby else "[]"
    rows: list[tuple[Cell, ...]] = []
    with TemporaryDirectory() as folder:

        def run(start: str, fault: str = "") -> Recorded:
            place = Path(folder, str(len(list(Path(folder).iterdir()))))
            length, out = ("--duration", LENGTH), ("--out", str(place))
            if words.real and fault:
                command = ("launch", words.scenario, "--from", start, *length, "--pace", "1")
                settings = ("--fault", fault, "--set", f"standby={standby}")
                harness.run([str(harness.OURS), *command, *settings, *out])
            else:
                heliarch.simulate(
                    words.scenario,
                    start=start,
                    duration=LENGTH,
                    faults=(fault,) if fault else (),
                    settings={"standby": json.loads(standby)} if fault else {},
                    out=place,
                )
            return recorded(place)

        starts = STARTS[:1] if words.real else STARTS
        healthy = [run(start) for start in starts]
        for victim in words.only.split(","):
            for name in FAULTS:
                found = [run(start, FAULTS[name].format(victim)) for start in starts]
                worst = map(max, zip(*map(figures, repeat(victim), found, healthy), strict=True))
                numbers = (None if number < 0.0 else number for number in worst)
                rows.append((VICTIMS.get(victim, victim), name, *numbers))
    how = "real processes" if words.real else "simulated"
    title = f"{words.scenario}, {how}, {'with' if words.standby else 'without'} standby"
    keys = (key_column("Controller"), key_column("Fault"))
    measures = (
        *(("noticed", "s", 2), ("normal", "s", 1), ("over", "kW", 0), ("over", "kWh", 2)),
        *(("under", "kW", 0), ("under", "kWh", 2), ("missing", "", 0)),
    )
    columns = (*keys, *(Column(*measure) for measure in measures))
    print_table(Console(width=100), Table(title, columns, rows))


def recorded(folder: Path) -> Recorded:
    """Read what the figures rest on from a recording."""
    sent: set[tuple[str, int]] = set()
    lacking = []
    start_ns = 0
    with open_run(folder) as run:
        publisher_of = {str(port): port.publisher for port in run.plan.wiring.ports}
        for port, message in run.messages():
            if isinstance(message, Run):
                start_ns = message.start_time_ns if message.state == "start" else start_ns
                continue
            if run.plan.period(port) and port.signal.name not in {"help", "notice", "takeover"}:
                sent.add((str(port), message.cycle))
            time_s = (message.publish_time_ns - start_ns) / 1e9
            for entry in message.missing:
                publisher = publisher_of[parse_missing(entry).key]
                lacking.append((time_s, message.cycle, publisher, port.publisher))
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    plant = read_plant_series(folder / RECORDING_NAME)
    return Recorded(plant, sent, lacking, summary["faults"].get("lost", 0))


def figures(victim: str, found: Recorded, healthy: Recorded) -> Iterator[float]:
    """Yield the numbers of a row; -1 for a time at which nothing came about."""
    after = [
        (time_s, cycle)
        for time_s, cycle, *ends in found.lacking
        if time_s >= AT_S and any(fnmatchcase(agent, victim) for agent in ends)
    ]
    noticed_s = min((time_s for time_s, _ in after), default=None)
    yield -1.0 if noticed_s is None else noticed_s - AT_S
    power_kw, healthy_kw = found.plant.delivered_kw, healthy.plant.delivered_kw
    apart_kw = np.abs(power_kw - healthy_kw)
    apart = np.flatnonzero(apart_kw > NEAR_SHARE * found.plant.rating_kw.sum())
    last = max([*apart.tolist(), *(cycle for _, cycle in after)], default=None)
    yield -1.0 if last is None else last + 1 - AT_S
    over_kw = power_kw - np.maximum(found.plant.desired_kw, healthy_kw)
    under_kw = np.minimum(found.plant.desired_kw, healthy_kw) - power_kw
    for kw in (over_kw, under_kw):
        yield max(float(kw.max()), 0.0)
        yield float(np.maximum(kw, 0.0).sum()) / 3600.0
    yield float(len(healthy.sent - found.sent) + found.lost)


if __name__ == "__main__":
    main()
