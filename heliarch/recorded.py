"""A recorded run, as scripts and notebooks read it."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Collection, Iterator
from dataclasses import fields
from functools import cached_property, wraps
from html import escape
from inspect import Parameter, Signature, signature
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Final, ParamSpec, TypeVar, get_args, get_type_hints

import pandas as pd

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.errors import InputError, InputWarning
from bus_schemas.messages import Message
from bus_schemas.signals import Signal
from recordings.read.reader import RunReader
from recordings.read.run_file import SUMMARY_NAME
from recordings.read.series import RunSeries, plant_series_of
from results.figures import FIGURES, Shown, run_figures, shown_in
from results.headline import curve_lines
from results.highlights import highlights
from results.run_document import RunDocument, document_in
from results.timing.stages import stage_table
from scenarios.run_options import RunOptions
from scenarios.times import When

if TYPE_CHECKING:
    import plotly.graph_objects as go


P = ParamSpec("P")
T = TypeVar("T")

_PARAMETERS: Final = {
    "--from": "start",
    "--to": "end",
    "--set": "settings",
    "--fault": "faults",
    "--device": "devices",
    "--external-timeout": "external_timeout_s",
}
"""Parameters that are not named as the option of the command is."""


_UNITS: Final = {
    **{"_kw": "kW", "_kwh": "kWh", "_kw_per_min": "kW/min"},
    **{"_hz": "Hz", "_s": "s", "_ns": "ns"},
}
"""Units by the endings of names of columns."""


def by_parameter(function: Callable[P, T]) -> Callable[P, T]:
    """Let errors of a function name its parameters in place of the command's options.

    Its signature lists the options that it takes by name, for notebooks to complete.
    """

    @wraps(function)
    def call(*words: P.args, **options: P.kwargs) -> T:
        try:
            return function(*words, **options)
        except InputError as error:
            raise error.renamed(_as_parameters(error.field)) from error.__cause__

    call.__dict__["__signature__"] = _with_options(function)
    return call


def _with_options(function: Callable[..., object]) -> Signature:
    """Return a signature that names what `**options: Unpack[...]` stands for."""
    found, parameters = signature(function), list[Parameter]()
    defaults = {one.name: one.default for one in fields(RunOptions)}
    for one in found.parameters.values():
        if one.kind is not Parameter.VAR_KEYWORD:
            parameters.append(one)
            continue
        (options,) = get_args(get_type_hints(function)[one.name])
        for name, kind in get_type_hints(options).items():
            known = {"default": defaults[name], "annotation": kind}
            parameters.append(Parameter(name, Parameter.KEYWORD_ONLY, **known))
    return found.replace(parameters=parameters)


def _as_parameters(field: str) -> str:
    """Return `start` of `--from`, `faults RULE` of `--fault RULE`; other fields as they are."""
    names = (name.split(" ", 1) for name in field.split(", "))
    return ", ".join(" ".join([_parameter(first), *rest]) for first, *rest in names)


def _parameter(option: str) -> str:
    is_option = option.startswith("--")
    return _PARAMETERS.get(option, option[2:].replace("-", "_")) if is_option else option


class Run:
    """A recorded run: its messages, tables, figures of merit and summary.

    What is damaged or missing in its recording is named when it is read. The files are closed at
    the end of a `with` block, or when nobody needs the run any more, as in a notebook.
    """

    def __init__(self, path: Path) -> None:
        self._reader = RunReader(path)
        if not self._reader.whole:
            text = "it was cut, is damaged or is still being recorded: a part of the run is missing"
            warnings.warn(f"{self.path}: {text}", InputWarning, stacklevel=3)

    @property
    def path(self) -> Path:
        """The recording: `run.path.stat().st_size`."""
        return self._reader.path

    @property
    def folder(self) -> Path:
        """The folder of the run: `run.folder / "report.html"`."""
        return self.path.parent

    @property
    def plan(self) -> RunPlan:
        """What the run was to do, as all its agents agreed on it: `run.plan.timing.cycles`."""
        return self._reader.plan

    @property
    def scenario(self) -> str:
        """The scenario's TOML text: `tomllib.loads(run.scenario)["time"]`."""
        return self._reader.scenario

    @property
    def summary(self) -> RunDocument:
        """What is in `summary.json`: `run.summary.highlights.hard_minutes`.

        Raises FileNotFoundError: The run has not ended; InputError: It is of another version.
        """
        found, why_not = document_in(self.folder, self.plan.run_id)
        if found is None:
            error = InputError if (self.folder / SUMMARY_NAME).exists() else FileNotFoundError
            raise error(f"{self.folder}: {why_not}")
        return found

    @by_parameter
    def messages(
        self,
        *signals: Signal[Message] | str,
        nodes: str | Collection[str] = (),
        start: When | None = None,
        end: When | None = None,
    ) -> Iterator[Delivery]:
        """Yield messages with their ports, in the order in which they were recorded.

        `[message.power_kw for port, message in run.messages("impp", nodes="c2/*")]`

        signals, nodes: Which signals and which nodes; by default all.
        start, end: The first cycle, and the one before which to end: a local time (`13:49:00`), a
            time since the start (`90s`; a number is seconds) or a cycle (`c90`).
        """
        return self._named_at_end(
            self._reader.messages(*signals, nodes=nodes, start=start, end=end)
        )

    def _named_at_end(self, messages: Iterator[Delivery]) -> Iterator[Delivery]:
        yield from messages
        self._reader.warn_of_damage()

    def frame(
        self,
        table: Signal[Message] | str,
        *,
        nodes: str | Collection[str] = (),
        start: When | None = None,
        end: When | None = None,
    ) -> pd.DataFrame:
        """Return the messages of one signal as a table, one row each; for the rest see `messages`.

        `run.frame("setpoint", nodes="c2/inv07", start="12:00:10", end="12:00:20")`

        It is indexed by `time`, the local time at the beginning of the cycle. Columns are `cycle`,
        `node` and the signal's own fields, with units in their names and in `attrs["units"]`. The
        lists inside messages have tables too: `help_given`, `production_inverters`,
        `production_storages`, `given_up_agents`, `missing_inputs`.
        """
        (found,) = self.frames(table, nodes=nodes, start=start, end=end).values()
        return found

    @by_parameter
    def frames(
        self,
        *tables: Signal[Message] | str,
        nodes: str | Collection[str] = (),
        start: When | None = None,
        end: When | None = None,
    ) -> dict[str, pd.DataFrame]:
        """Return several tables by name, each as `frame` does: the recording is read once.

        `run.frames("impp", "setpoint")["setpoint"].share_kw.max()`
        """
        found = self._reader.frames(*tables, nodes=nodes, start=start, end=end)
        self._reader.warn_of_damage()
        for table in found.values():
            table.attrs["units"] = {
                name: unit
                for name in table
                for ending, unit in _UNITS.items()
                if str(name).endswith(ending)
            }
        return found

    @cached_property
    def _series(self) -> RunSeries:
        series = plant_series_of(self._reader)
        self._reader.warn_of_damage()
        return series

    @cached_property
    def plant(self) -> pd.DataFrame:
        """Dispatch, delivered, available power, baseline and shortfall of the plant [kW] by time.

        `run.plant["shortfall_kw"].idxmax()` is when most was missed. `without_help_kw` is what the
        same sky would have given without help between inverters.
        """
        series = self._series
        columns = {
            "dispatch_kw": series.desired_kw,
            "delivered_kw": series.delivered_kw,
            "available_kw": series.available_kw,
            "without_help_kw": series.without_help_kw,
            "shortfall_kw": series.shortfall_kw,
        }
        return _in_kw(pd.DataFrame(columns, series.times.rename("time")))

    @cached_property
    def metrics(self) -> pd.Series:
        """Figures of merit by name, see docs/metrics.md: `run.metrics["control-caused"]`.

        NaN: not defined here. `attrs["units"]` has their units.
        """
        found = pd.Series(run_figures(self._series), name=self.plan.run_id, dtype=float)
        found.attrs["units"] = {name: FIGURES[name].unit for name in found.index}
        return found

    @cached_property
    def power(self) -> pd.DataFrame:
        """Power of each inverter [kW] by local time: `run.power["c2/inv07"].max()`."""
        series = plant_series_of(self._reader, most_inverters=None)
        self._reader.warn_of_damage()
        table = pd.DataFrame(series.power_kw, series.times.rename("time"), list(series.inverters))
        return _in_kw(table)

    def plot(self) -> go.Figure:
        """Draw the report's figure with plotly: `run.plot().to_html()`, or `.show()`."""
        from results.report.run_report import power_figure  # noqa: PLC0415 - plotly is an extra

        return power_figure(self._reader)

    def stages(self) -> pd.DataFrame:
        """Return the tidy table of a run in real time: a row for each stage in each cycle.

        `run.stages().head()`; docs/timing.md describes its columns, and the groupby on it behind
        each figure of `timing`.
        """
        table = stage_table(self._reader)
        self._reader.warn_of_damage()
        return table

    def close(self) -> None:
        """Close its files: `run.close()`."""
        self._reader.close()

    def __enter__(self) -> Run:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        missed = self.metrics["control-caused"]
        kept = "nothing was promised" if isnan(missed) else f"missed {missed:.3f} % of its promise"
        return f"<Run {self.plan.run_id}: {len(self.plant):,} cycles, {kept}, in {self.folder}>"

    def _repr_html_(self) -> str:
        """Return the run for notebooks: its power as curves, and its figures of merit."""
        shown = {
            f"{one.title} [{one.unit}]": round(self.metrics[one.name], one.decimals)
            for one in shown_in(Shown.SUMMARY)
            if not isnan(self.metrics[one.name])
        }
        table = pd.Series(shown, name=self.plan.run_id, dtype=object).to_frame()
        curve = highlights(self._series).curve
        drawn = escape("\n".join(curve_lines(curve, can_draw=True, width=80)))
        return f"{escape(repr(self))}<pre>{drawn}</pre>{table.to_html(border=0)}"

    def __del__(self) -> None:
        if reader := getattr(self, "_reader", None):  # There is none if it could not be opened.
            reader.release()


def _in_kw(table: pd.DataFrame) -> pd.DataFrame:
    table.attrs["units"] = dict.fromkeys(table.columns, "kW")
    return table


def with_units(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with its units in the header: `power_kw` becomes `power [kW]`.

    `heliarch.with_units(run.plant).to_csv("plant.csv")`
    """
    ending = re.compile(f"({'|'.join(_UNITS)})$")
    units = table.attrs.get("units", {}).items()
    return table.rename(columns={name: f"{ending.sub('', name)} [{unit}]" for name, unit in units})


def open_run(path: Path | str) -> Run:
    """Open a recording, by its run's folder or its MCAP file.

    Examples
    --------
    >>> with open_run("runs/oahu-20261121-120000-4711") as run:
    ...     impp = run.frame("impp", nodes="c2/inv07", start="12:20", end="12:30")
    """
    return Run(Path(path))
