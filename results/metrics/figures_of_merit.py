"""The figures of merit of a run: the one list of their names, units, decimals and tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Flag, auto
from typing import Final, TypeAlias, TypeVar

from results.metrics.run import RunMetrics
from results.tables import Cell, Column, Number, Table, key_column


class Shown(Flag):
    """Where tables show a figure, and whether more of it is better. JSON has all figures."""

    SUMMARY = auto()
    """At the end of a run, and on the live page."""
    REPORT = auto()
    COMPARE = auto()
    """In `compare` of one case."""
    MORE_IS_BETTER = auto()


@dataclass(frozen=True, slots=True)
class FigureOfMerit:
    """One figure of merit: its name in JSON and on the command line, and how tables show it.

    `read` returns its value in a run; None where the run does not define it.
    """

    name: str
    title: str
    unit: str
    decimals: int
    shown: Shown
    read: Callable[[RunMetrics], float | None]

    @property
    def is_more_better(self) -> bool:
        """Whether of two runs the one with more of it is better."""
        return Shown.MORE_IS_BETTER in self.shown

    @property
    def heading(self) -> str:
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    @property
    def column(self) -> Column:
        return Column(self.title, self.unit, self.decimals, name=self.name)


_Part = TypeVar("_Part")
_Row: TypeAlias = tuple[str, str, str, int, Shown, Callable[[_Part], float | None]]


def _figures_of(
    part: Callable[[RunMetrics], _Part | None], rows: Sequence[_Row[_Part]]
) -> Iterator[FigureOfMerit]:
    """Return the figures of one part of the metrics, which a run may not have."""
    for name, title, unit, decimals, shown, of_part in rows:

        def read(
            metrics: RunMetrics, of_part: Callable[[_Part], float | None] = of_part
        ) -> float | None:
            found = part(metrics)
            return None if found is None else of_part(found)

        yield FigureOfMerit(name, title, unit, decimals, shown, read)


_NOWHERE: Final = Shown(0)
_R: Final = Shown.REPORT
_C: Final = Shown.COMPARE
_SR: Final = Shown.SUMMARY | Shown.REPORT
_SRC: Final = _SR | Shown.COMPARE
_MORE: Final = Shown.MORE_IS_BETTER

# fmt: off
COMMITMENT: Final = (
    *_figures_of(lambda run: run.commitment, (
        ("dispatched-energy", "Dispatched energy", "kWh", 1, _SR, lambda of: of.dispatched_kwh),
        ("available-energy", "Available energy", "kWh", 1, _SR, lambda of: of.available_kwh),
        ("delivered-energy", "Delivered energy", "kWh", 1, _SR, lambda of: of.delivered_kwh),
        ("satisfied", "Satisfied commitment", "%", 3, _SRC | _MORE,
         lambda of: of.satisfied_percent),
        ("shortfall-energy", "Shortfall", "kWh", 2, _SRC, lambda of: of.shortfall_kwh),
        ("unavoidable-energy", "Shortfall, unavoidable", "kWh", 2, _SR,
         lambda of: of.unavoidable_kwh),
        ("control-caused-energy", "Shortfall, control-caused", "kWh", 2, _SR,
         lambda of: of.control_caused_kwh),
        ("over-delivered-energy", "Over-delivery", "kWh", 2, _SR,
         lambda of: of.over_delivered_kwh),
        ("shortfall", "Shortfall", "% of dispatch", 3, _NOWHERE,
         lambda of: of.percent(of.shortfall_kwh)),
        ("unavoidable", "Unavoidable", "% of dispatch", 3, _C,
         lambda of: of.percent(of.unavoidable_kwh)),
        ("control-caused", "Control-caused", "% of dispatch", 3, _C,
         lambda of: of.percent(of.control_caused_kwh)),
        ("over-delivered", "Over-delivered", "% of dispatch", 3, _C,
         lambda of: of.percent(of.over_delivered_kwh)),
    )),
    *_figures_of(lambda run: run.tracking, (
        ("rmse", "Tracking RMSE", "kW", 2, _SRC, lambda of: of.rmse_kw),
        ("mae", "Tracking MAE", "kW", 2, _R, lambda of: of.mae_kw),
    )),
    *_figures_of(lambda run: run.mileage, (
        ("mileage-total", "Mileage, whole run", "kW", 0, _R, lambda of: of.total_kw),
        ("mileage", "Mileage per hour", "kW/h", 0, _SRC, lambda of: of.per_hour_kw),
        ("mileage-per-minute", "Mileage per minute", "kW/min", 1, _R, lambda of: of.per_minute_kw),
    )),
    *_figures_of(lambda run: run.headroom, (
        ("curtailed-energy", "Curtailed energy", "kWh", 1, _R, lambda of: of.curtailed_kwh),
        ("mean-headroom", "Mean headroom", "kW", 1, _R, lambda of: of.mean_headroom_kw),
        ("ancillary-potential", "Ancillary potential", "kWh", 1, _R,
         lambda of: of.ancillary_potential_kwh),
    )),
    *_figures_of(lambda run: run.ramps, (
        ("rise", "Largest rise", "kW/min", 1, _R, lambda of: of.largest_up_kw_per_min),
        ("fall", "Largest fall", "kW/min", 1, _R, lambda of: of.largest_down_kw_per_min),
        ("ramp", "Largest ramp", "kW/min", 0, Shown.SUMMARY, lambda of: of.largest_kw_per_min),
        ("ramp-limit", "Ramp limit", "kW/min", 0, _R, lambda of: of.limit_kw_per_min),
        ("above-ramp-limit", "Minutes above the ramp limit", "%", 2, _SR,
         lambda of: of.above_limit_percent),
    )),
)
"""How the commitment was kept, in the order in which tables show it."""

AGENTS: Final = (
    *_figures_of(lambda run: run.help, (
        ("outside-help", "Help from outside the cluster", "%", 1, _C,
         lambda of: of.outside_percent),
        ("outside-help-able", "Help from outside, plant able", "%", 1, _C,
         lambda of: of.outside_able_percent),
    )),
    *_figures_of(lambda run: run, (
        ("missed-inputs", "Inputs missed", "", 0, _C, lambda of: of.missed_inputs),
        ("reverted", "Reverted", "%", 2, _C, lambda of: of.reverted_percent),
    )),
)
"""What the agents had to do for it; without residuals there are none."""

REGULATION: Final = (
    *_figures_of(lambda run: run.regulation, (
        ("capacity", "Regulation capacity", "kW", 0, _R, lambda of: of.capacity_kw),
        ("offered", "Regulation offered", "h", 2, _R, lambda of: of.offered_h),
        ("signal-mileage", "Mileage of the signal", "1/h", 2, _R,
         lambda of: of.signal_mileage_per_hour),
        ("regd-strict", "Requests fulfilled to 0.1 %", "%", 2, _SRC | _MORE,
         lambda of: of.requests[0].fulfilled_percent),
        ("regd", "Requests fulfilled to 1 %", "%", 2, _SRC | _MORE,
         lambda of: of.requests[1].fulfilled_percent),
        ("regd-feasible-strict", "Feasible requests fulfilled to 0.1 %", "%", 2, _R | _C | _MORE,
         lambda of: of.requests[0].feasible_fulfilled_percent),
        ("regd-feasible", "Feasible requests fulfilled to 1 %", "%", 2, _R | _C | _MORE,
         lambda of: of.requests[1].feasible_fulfilled_percent),
    )),
    *_figures_of(lambda run: run.regulation.performance if run.regulation else None, (
        ("accuracy", "Accuracy", "", 3, _R | _C | _MORE, lambda of: of.accuracy),
        ("delay", "Delay", "", 3, _R | _C | _MORE, lambda of: of.delay),
        ("precision", "Precision", "", 3, _R | _C | _MORE, lambda of: of.precision),
        ("score", "PJM performance score", "", 3, _SRC | _MORE, lambda of: of.score),
        ("score-unclipped", "PJM score, accuracy not clipped", "", 3, _R | _C | _MORE,
         lambda of: of.unclipped_score),
    )),
)
"""How a regulation signal was followed."""
# fmt: on

FIGURES_OF_MERIT: Final = {figure.name: figure for figure in (*COMMITMENT, *AGENTS, *REGULATION)}
"""All figures of merit by name, in the order in which tables show them."""


def shown_in(
    place: Shown, figures: Sequence[FigureOfMerit] = (*COMMITMENT, *AGENTS, *REGULATION)
) -> tuple[FigureOfMerit, ...]:
    """Return the figures that are shown at a place."""
    return tuple(figure for figure in figures if place & figure.shown)


def figures_json(metrics: RunMetrics) -> dict[str, float | None]:
    return {name: figure.read(metrics) for name, figure in FIGURES_OF_MERIT.items()}


def runs_as_columns(
    title: str,
    runs: Sequence[tuple[str, RunMetrics]],
    figures: Sequence[FigureOfMerit],
    notes: tuple[str, ...] = (),
    *,
    difference: bool = False,
) -> Table:
    """Return a table with a row for each figure and a column for each labelled run.

    Figures that no run defines are left out. With `difference`, a last column has the second of
    two runs less the first.
    """
    labels = [label for label, _ in runs]
    rows: list[tuple[Cell, ...]] = []
    for figure in figures:
        values = [figure.read(metrics) for _, metrics in runs]
        if all(value is None for value in values):
            continue
        if difference:
            first, second = values
            values.append(None if first is None or second is None else second - first)
        cells = (Number(value, figure.decimals) for value in values)
        rows.append((figure.title, figure.unit, *cells))
    if difference:
        labels.append("difference")
    columns = (key_column("", "figure"), key_column("", "unit"), *map(Column, labels))
    return Table(title, columns, tuple(rows), notes)
