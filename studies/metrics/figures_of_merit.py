"""The figures of merit of a run: the one list of their names, units, decimals and places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

from studies.metrics.run import RunMetrics
from studies.tables import Cell, Column, Number, Table, key_column

Place: TypeAlias = Literal["summary", "report", "compare", "delays"]
"""The end of a run, its report, `compare` of one case, `delays`. JSON has all figures."""

_LETTERS: Final[dict[Place, str]] = {"summary": "S", "report": "R", "compare": "C", "delays": "D"}


@dataclass(frozen=True, slots=True)
class FigureOfMerit:
    """One figure of merit: its name in JSON and on the command line, and how tables show it.

    `shown` has the letters of the places that show it; a `+` says that more of it is better. `path`
    is where `RunMetrics` has it; of a figure in % of desired, the energy.
    """

    name: str
    title: str
    unit: str
    decimals: int
    shown: str
    path: str

    @property
    def is_more_better(self) -> bool:
        """Whether of two runs the one with more of it is better."""
        return self.shown.endswith("+")

    @property
    def heading(self) -> str:
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    @property
    def column(self) -> Column:
        return Column(self.title, self.unit, self.decimals, name=self.name)

    def read(self, metrics: RunMetrics) -> float | None:
        """Return its value in a run; None where the run does not define it."""
        found: Any = metrics
        for name in self.path.split("."):
            if found is not None:
                found = found[int(name)] if name.isdecimal() else getattr(found, name)
        return metrics.commitment.percent(found) if self.unit == "% of desired" else found


# fmt: off
_ROWS: Final = (
    ("desired-energy", "Desired energy", "kWh", 1, "SR", "commitment.desired_kwh"),
    ("possible-energy", "Possible energy", "kWh", 1, "SR", "commitment.possible_kwh"),
    ("delivered-energy", "Delivered energy", "kWh", 1, "SR", "commitment.delivered_kwh"),
    ("satisfied", "Satisfied commitment", "%", 3, "SRC+", "commitment.satisfied_percent"),
    ("shortfall-energy", "Shortfall", "kWh", 2, "SRC", "commitment.unsatisfied_kwh"),
    ("unavoidable-energy", "Shortfall, unavoidable", "kWh", 2, "SR",
     "commitment.unavoidable_kwh"),
    ("control-caused-energy", "Shortfall, control-caused", "kWh", 2, "SR",
     "commitment.control_caused_kwh"),
    ("over-delivered-energy", "Over-delivery", "kWh", 2, "SR", "commitment.over_delivered_kwh"),
    ("shortfall", "Shortfall", "% of desired", 3, "", "commitment.unsatisfied_kwh"),
    ("unavoidable", "Unavoidable", "% of desired", 3, "C", "commitment.unavoidable_kwh"),
    ("control-caused", "Control-caused", "% of desired", 3, "CD", "commitment.control_caused_kwh"),
    ("over-delivered", "Over-delivered", "% of desired", 3, "CD", "commitment.over_delivered_kwh"),
    ("rmse", "Tracking RMSE", "kW", 2, "SRC", "tracking.rmse_kw"),
    ("mae", "Tracking MAE", "kW", 2, "R", "tracking.mae_kw"),
    ("mileage-total", "Mileage, whole run", "kW", 0, "R", "support.total_kw"),
    ("mileage", "Mileage per hour", "kW/h", 0, "SRCD", "support.per_hour_kw"),
    ("mileage-per-minute", "Mileage per minute", "kW/min", 1, "R", "support.per_minute_kw"),
    ("headroom", "Headroom kept", "kWh", 1, "R", "headroom.headroom_kwh"),
    ("mean-headroom", "Headroom kept, mean", "kW", 1, "R", "headroom.mean_headroom_kw"),
    ("ancillary-potential", "Ancillary potential", "kWh", 1, "R",
     "headroom.ancillary_potential_kwh"),
    ("rise", "Largest rise", "kW/min", 1, "R", "ramps.largest_up_kw_per_min"),
    ("fall", "Largest fall", "kW/min", 1, "R", "ramps.largest_down_kw_per_min"),
    ("ramp", "Largest ramp", "kW/min", 0, "S", "ramps.largest_kw_per_min"),
    ("ramp-limit", "Ramp limit", "kW/min", 0, "R", "ramps.limit_kw_per_min"),
    ("above-ramp-limit", "Minutes above the ramp limit", "%", 2, "SR",
     "ramps.above_limit_percent"),
    ("capacity", "Regulation capacity", "kW", 0, "R", "regulation.capacity_kw"),
    ("offered", "Regulation offered", "h", 2, "R", "regulation.offered_h"),
    ("signal-mileage", "Mileage of the signal", "1/h", 2, "R",
     "regulation.signal_mileage_per_hour"),
    ("regd-strict", "Requests fulfilled to 0.1 %", "%", 2, "SRC+",
     "regulation.requests.0.fulfilled_percent"),
    ("regd", "Requests fulfilled to 1 %", "%", 2, "SRCD+",
     "regulation.requests.1.fulfilled_percent"),
    ("regd-feasible-strict", "Feasible requests fulfilled to 0.1 %", "%", 2, "RC+",
     "regulation.requests.0.feasible_fulfilled_percent"),
    ("regd-feasible", "Feasible requests fulfilled to 1 %", "%", 2, "RC+",
     "regulation.requests.1.feasible_fulfilled_percent"),
    ("accuracy", "Accuracy", "", 3, "RC+", "regulation.performance.accuracy"),
    ("delay", "Delay", "", 3, "RC+", "regulation.performance.delay"),
    ("precision", "Precision", "", 3, "RC+", "regulation.performance.precision"),
    ("score", "PJM performance score", "", 3, "SRCD+", "regulation.performance.score"),
    ("score-unclipped", "PJM score, accuracy not clipped", "", 3, "RC+",
     "regulation.performance.unclipped_score"),
)
# fmt: on

FIGURES_OF_MERIT: Final = {row[0]: FigureOfMerit(*row) for row in _ROWS}
"""All figures of merit by name, in the order in which tables show them."""


def shown_in(
    place: Place, group: Literal["commitment", "regulation"] | None = None
) -> tuple[FigureOfMerit, ...]:
    """Return the figures that are shown at a place, of one group or of both."""
    return tuple(
        figure
        for figure in FIGURES_OF_MERIT.values()
        if _LETTERS[place] in figure.shown
        and (group is None or figure.path.startswith("regulation") == (group == "regulation"))
    )


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
