"""Plants run in real time and timed: at one rate, or at several to find the highest clean one."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Final, Literal

import msgspec
import psutil

from agents.process.interruption import interruptible
from agents.process.machine_watch import MachineWatch
from bus_schemas.errors import FailureError, InputError, listed
from launch_scripts.fork_server_process import fork_server
from launch_scripts.launch import check_processes, run_as_processes
from launch_scripts.run_folder import RunFolder, prepare_run
from launch_scripts.view import ViewFor
from results.report.result import Result
from results.tables import Column, Table, attributes, key_column, word_column
from results.timing.measures import LOOP
from results.timing.report import TimingReport, report_on
from results.timing.results import cycles_per_s, host_lines
from results.timing.stages import STOPS_NAME
from scenarios.preparation import Preparation, RunOptions
from scenarios.scenario import ScenarioFile
from scenarios.times import parse_duration_s

HIGHEST_HZ: Final = 1000.0
LOWEST_HZ: Final = 1.0 / 3600.0
_AUTO: Final = f"5..{HIGHEST_HZ:g}"

_CLOSE_ENOUGH: Final = 1.1
"""The search ends where the lowest rate that fails is no further above the highest clean one."""

_EXPECTED: Final = (
    "cycles a second such as 20, or a range such as 1..200 or auto, from one cycle an hour "
    f"(0.000278) to {HIGHEST_HZ:g}"
)

LEAST_CYCLES: Final = 120
"""Of fewer than 100 cycles the p99 would be the longest one."""


def prepare_at(
    rate_hz: float, default_s: float, file: ScenarioFile, asked: RunOptions, out: Path | None
) -> tuple[Preparation, RunFolder]:
    """Prepare a run at a rate, its length rounded to whole cycles. Nothing is written yet.

    It lasts up to `--to`, for `--duration`, or for its default, and then `LEAST_CYCLES` at least.
    """
    length_s = max(default_s, LEAST_CYCLES / rate_hz)
    if asked.end is not None:
        timing = prepare_run(file, asked)[0].plan.timing
        length_s = timing.cycles * timing.cycle_s
    elif asked.duration is not None:
        length_s = parse_duration_s(asked.duration, "--duration", 1.0 / rate_hz)
    if length_s * rate_hz < 1.0:
        raise InputError.of(
            f"--duration {length_s:g} s",
            f"shorter than one cycle, expected {1.0 / rate_hz:g} s or "
            f"more at {cycles_per_s(rate_hz)}",
        )
    cycle_s = 1.0 / rate_hz
    duration = f"{round(length_s * rate_hz) * cycle_s:.9f}"
    options = replace(asked, pace="1", cycle_s=cycle_s, duration=duration, end=None)
    preparation, folder = prepare_run(file, options, out)
    check_processes(preparation.plan)
    return preparation, folder


def measured_run(preparation: Preparation, folder: RunFolder, view_for: ViewFor) -> TimingReport:
    plan, scenario = preparation.plan, preparation.scenario.scenario
    duration_s = plan.timing.cycles * plan.timing.cycle_wall_ns / 1e9
    began_at, load_before = time.monotonic(), psutil.getloadavg()[0]
    with fork_server() as server, MachineWatch() as watch, view_for(plan) as view:
        view.say(scenario.title)
        view.say(f"{cycles_per_s(1e9 / plan.timing.cycle_wall_ns)} for {round(duration_s, 2):g} s")
        summary = run_as_processes(preparation, folder, view, began_at, server)
        stops = watch.stops()
        with interruptible():  # The run is over: Ctrl-C throws nothing away any more.
            folder.write_summary(summary.as_json())
            (folder.path / STOPS_NAME).write_bytes(msgspec.json.encode(stops))
    try:
        return report_on(folder.path, summary, (load_before, psutil.getloadavg()[0]), stops)
    except InputError as error:  # The disk was full, for instance.
        raise FailureError(f"{summary.recording_ended or 'not measured'}: {error}") from None


# The highest rate ---------------------------------------------------------------------------------


class RateRow(msgspec.Struct, frozen=True):
    """The run at one rate; `reason` says why it failed, or which budgets it did not keep.

    Of a rate that was interrupted nothing is proved.
    """

    rate_hz: float
    outcome: Literal["clean", "not clean", "failed", "interrupted"]
    reason: str = ""
    cycles: int = 0
    late_cycles: int = 0
    lost_messages: int | None = None
    loop_p50_ms: float | None = None
    loop_p99_ms: float | None = None
    loop_max_ms: float | None = None
    host: tuple[str, ...] = ()


def parse_rates(text: str) -> tuple[float, float]:
    """Read the value of `--rate`: the ends of a search [1/s], which are equal for a single rate."""
    parts = (_AUTO if text == "auto" else text).split("..")
    with suppress(ValueError):
        rates = [float(part) for part in parts]
        is_range = len(rates) <= 2 and rates == sorted(set(rates))
        if is_range and rates[0] >= LOWEST_HZ and rates[-1] <= HIGHEST_HZ:
            return rates[0], rates[-1]
    raise InputError.of("--rate", f"expected {_EXPECTED}, got {text}")


def sweep(
    lowest_hz: float, highest_hz: float, timed: Callable[[float], TimingReport]
) -> list[RateRow]:
    """Search for the highest clean rate, doubling, then halving steps; return all rates, ascending.

    A rate that was not clean is run once more, and the second run counts: one stall of the machine
    must not end the search. If the very first rate is refused, so is the sweep.
    """
    rows: dict[float, RateRow] = {}
    rate_hz, clean_hz, too_fast_hz = lowest_hz, 0.0, inf
    while clean_hz < highest_hz and too_fast_hz > clean_hz * _CLOSE_ENOUGH:
        row = _run_at(rate_hz, timed, is_first=not rows)
        if row.outcome == "not clean":
            row = _run_at(rate_hz, timed, is_first=False)
        rows[rate_hz] = row
        if row.outcome == "clean":
            clean_hz = rate_hz
        else:
            too_fast_hz = rate_hz
        if row.outcome == "interrupted" or not clean_hz:
            break
        rate_hz = min(2.0 * clean_hz, highest_hz)
        if too_fast_hz < inf:
            rate_hz = float(f"{(clean_hz * too_fast_hz) ** 0.5:.3g}")
    return [rows[hz] for hz in sorted(rows)]


def _run_at(rate_hz: float, timed: Callable[[float], TimingReport], *, is_first: bool) -> RateRow:
    try:
        report = timed(rate_hz)
    except KeyboardInterrupt:
        return RateRow(rate_hz, "interrupted")
    except (FailureError, InputError) as failure:
        if is_first and isinstance(failure, InputError):
            raise
        return RateRow(rate_hz, "failed", str(failure).splitlines()[0])
    return rate_row(report)


def rate_row(report: TimingReport) -> RateRow:
    run, loop_ms = report.run, report.times[report.times["of"] == LOOP].iloc[0]
    failed = [budget.line for budget in report.budgets if not budget.passed]
    return RateRow(
        rate_hz=run.rate_hz,
        outcome="interrupted" if run.interrupted else "clean" if report.passed else "not clean",
        reason=f"not kept: {listed(failed, 5)}" if failed else "",
        cycles=run.cycles,
        late_cycles=run.late_cycles,
        lost_messages=run.lost_messages,
        **{f"loop_{name}_ms": float(loop_ms[f"{name}_ms"]) for name in ("p50", "p99", "max")},
        host=tuple(host_lines(report)),
    )


def sweep_result(rates: Sequence[RateRow], scenario: str) -> Result:
    hosts = [row.host for row in rates if row.host]
    clean_hz = max((row.rate_hz for row in rates if row.outcome == "clean"), default=None)
    failed_hz = [row.rate_hz for row in rates if row.outcome in {"failed", "not clean"}]
    columns = (
        key_column("rate", "rate_hz"),
        Column("cycles"),
        *(Column(f"loop {name}", "ms", name=f"loop_{name}_ms") for name in ("p50", "p99", "max")),
        Column("late cycles", name="late_cycles"),
        Column("lost", name="lost_messages"),
        word_column("", "outcome"),
        word_column("", "reason"),
    )
    rows = [(f"{row[0]:.4g}", *row[1:]) for row in attributes(rates, columns)]
    verdict = f"FAIL: no rate was clean: {len(rates)} tried, try lower ones"
    if any(row.outcome == "interrupted" for row in rates):
        verdict = "FAIL: interrupted before a rate was found to be clean"
    if clean_hz is not None:
        at_least = "" if failed_hz else "at least "
        highest = f"{at_least}{cycles_per_s(clean_hz)}"
        verdict = f"PASS: highest clean rate {highest} (all budgets kept)"
    return Result(
        f"{scenario}: loop time against rate",
        [Table("Rates [cycles/s]", columns, rows)],
        {
            "rows": rates,
            "highest_clean_hz": clean_hz,
            "too_fast_hz": min(failed_hz, default=None),
        },
        lines=hosts[-1] if hosts else (),
        verdict=(clean_hz is not None, verdict),
    )
