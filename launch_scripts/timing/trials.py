"""Runs of one plant at several rates, each in a folder of its own below that of the sweep."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import msgspec
from rich.console import Console

from bus_schemas.errors import InputError
from launch_scripts.preparation import Preparation
from launch_scripts.run_command import RunRequest
from launch_scripts.run_folder import RunFolder
from launch_scripts.supervision import RunFailure
from launch_scripts.termination import Termination
from launch_scripts.timing.measured_run import MeasuredRun, measured_run, prepare_at
from launch_scripts.timing.rates import cycles_per_s
from launch_scripts.timing.sweep import RateRow, rate_row
from launch_scripts.timing.timing_report import TimingReport, report_on


class Trials:
    """The runs of a sweep.

    Parameters
    ----------
    request
        What to run.
    duration
        How long, at each rate.
    folder
        Of the sweep.
    console
        Shows progress.
    termination
        Of the command: a signal does not cost a run that is over its figures.

    Attributes
    ----------
    latest
        The report of the last run that came to its end; None before that.
    unwritten
        Summaries of runs that could not be written, and why.
    """

    def __init__(
        self,
        request: RunRequest,
        duration: str,
        folder: Path,
        console: Console,
        termination: Termination,
    ) -> None:
        self.latest: TimingReport | None = None
        self.unwritten: list[str] = []
        self._request = request
        self._duration = duration
        self._folder = folder
        self._console = console
        self._termination = termination
        self._prepared: dict[float, tuple[Preparation, RunFolder]] = {}
        self._has_begun = False

    def prepare(self, rates_hz: Iterable[float]) -> None:
        """Work out the runs at rates that will be tried for certain, before any of them starts.

        Raises
        ------
        InputError
            One of them cannot be.
        """
        for rate_hz in rates_hz:
            out = self._folder / f"rate-{rate_hz:g}"
            self._prepared[rate_hz] = prepare_at(rate_hz, self._duration, self._request, out)

    def run(self, rate_hz: float) -> tuple[RateRow, bool]:
        """Run at a rate; tell what it came to, and whether the user wants no further one.

        Where the machine does not let a run begin or end, for instance since the disk is full, the
        rate has failed, which proves nothing.

        A rate that a search comes to may be refused, for instance since stated deadlines do not
        fit into the cycle. What was measured before counts all the same: the rate has failed.

        Raises
        ------
        InputError
            The first rate of all is refused.
        """
        try:
            run = self._run(rate_hz)
        except OSError as error:  # The disk is full, for instance.
            where = error.filename or self._folder
            row = self._failed(rate_hz, f"{where}: {error.strerror or error}")
            return msgspec.structs.replace(row, unwritable=True), False
        except InputError as error:
            if not self._has_begun:
                raise
            return self._failed(rate_hz, str(error)), False
        except RunFailure as failure:
            return self._failed(rate_hz, str(failure)), False
        finally:
            self._has_begun = True
        if run.unwritten:
            self.unwritten.append(run.unwritten)
        with self._termination.held():
            row = self._row(run, rate_hz)
        return row, row.interrupted or self._termination.number is not None

    def _row(self, run: MeasuredRun, rate_hz: float) -> RateRow:
        try:
            self.latest, _ = report_on(run)
        except RunFailure as failure:
            return self._failed(rate_hz, str(failure))
        return rate_row(self.latest)

    def _run(self, rate_hz: float) -> MeasuredRun:
        if rate_hz not in self._prepared:
            self.prepare([rate_hz])
        preparation, folder = self._prepared.pop(rate_hz)
        return measured_run(preparation, folder, self._console)

    def _failed(self, rate_hz: float, reason: str) -> RateRow:
        text = f"{cycles_per_s(rate_hz)}: {reason}"
        self._console.print(text, highlight=False, soft_wrap=True, markup=False)
        return RateRow(rate_hz, failed=reason.splitlines()[0])
