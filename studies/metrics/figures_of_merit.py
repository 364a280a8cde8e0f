"""The figures of merit of a run: the one list of their names, units, decimals and places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from studies.metrics.performance import PerformanceScore
from studies.metrics.run import RunMetrics
from studies.tables import Cell, Column, Number, Table, key_column

Place: TypeAlias = Literal["summary", "report", "compare", "delays"]
"""The end of a run, its report, `compare` of one case, `delays`. JSON has all figures."""

Group: TypeAlias = Literal["commitment", "regulation"]
Read: TypeAlias = Callable[[RunMetrics], float | None]

_PLACES: Final[dict[str, Place]] = {"S": "summary", "R": "report", "C": "compare", "D": "delays"}
_Row: TypeAlias = tuple[str, str, str, int, str, Read]
"""Name, title, unit, decimals, places by their letters (+: more is better), where it is found."""


@dataclass(frozen=True, slots=True)
class FigureOfMerit:
    """One figure of merit.

    Attributes
    ----------
    name
        In JSON and on the command line.
    title, unit, decimals
        How tables show it.
    group
        Which table it belongs to.
    places
        Where it is shown.
    is_more_better
        Whether of two runs the one with more of it is better.
    read
        Where it is found; None where the run does not define it.
    """

    name: str
    title: str
    unit: str
    decimals: int
    group: Group
    places: frozenset[Place]
    is_more_better: bool
    read: Read

    @property
    def heading(self) -> str:
        """Title and unit in one line."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    @property
    def column(self) -> Column:
        """A column of a table for it."""
        return Column(self.title, self.unit, self.decimals, name=self.name)


def _percent(energy: str) -> Read:
    """Read an energy in % of the desired energy."""
    return lambda m: m.commitment.percent(getattr(m.commitment, energy))


def _ramp(name: str) -> Read:
    return lambda m: getattr(m.ramps, name) if m.ramps else None


def _regulation(name: str) -> Read:
    return lambda m: getattr(m.regulation, name) if m.regulation else None


def _requests(place: int, name: str) -> Read:
    return lambda m: getattr(m.regulation.requests[place], name) if m.regulation else None


def _score(name: str) -> Read:
    def read(m: RunMetrics) -> float | None:
        score: PerformanceScore | None = m.regulation.performance if m.regulation else None
        return getattr(score, name) if score else None

    return read


# fmt: off
_COMMITMENT: Final[tuple[_Row, ...]] = (
    ("desired-energy", "Desired energy", "kWh", 1, "SR", lambda m: m.commitment.desired_kwh),
    ("possible-energy", "Possible energy", "kWh", 1, "SR", lambda m: m.commitment.possible_kwh),
    ("delivered-energy", "Delivered energy", "kWh", 1, "SR", lambda m: m.commitment.delivered_kwh),
    ("satisfied", "Satisfied commitment", "%", 3, "SRC+", lambda m: m.commitment.satisfied_percent),
    ("shortfall-energy", "Shortfall", "kWh", 2, "SRC", lambda m: m.commitment.unsatisfied_kwh),
    ("unavoidable-energy", "Shortfall, unavoidable", "kWh", 2, "SR",
     lambda m: m.commitment.unavoidable_kwh),
    ("control-caused-energy", "Shortfall, control-caused", "kWh", 2, "SR",
     lambda m: m.commitment.control_caused_kwh),
    ("over-delivered-energy", "Over-delivery", "kWh", 2, "SR",
     lambda m: m.commitment.over_delivered_kwh),
    ("shortfall", "Shortfall", "% of desired", 3, "", _percent("unsatisfied_kwh")),
    ("unavoidable", "Unavoidable", "% of desired", 3, "C", _percent("unavoidable_kwh")),
    ("control-caused", "Control-caused", "% of desired", 3, "CD", _percent("control_caused_kwh")),
    ("over-delivered", "Over-delivered", "% of desired", 3, "CD", _percent("over_delivered_kwh")),
    ("rmse", "Tracking RMSE", "kW", 2, "SRC", lambda m: m.tracking.rmse_kw),
    ("mae", "Tracking MAE", "kW", 2, "R", lambda m: m.tracking.mae_kw),
    ("mileage-total", "Mileage, whole run", "kW", 0, "R", lambda m: m.support.total_kw),
    ("mileage", "Mileage per hour", "kW/h", 0, "SRCD", lambda m: m.support.per_hour_kw),
    ("mileage-per-minute", "Mileage per minute", "kW/min", 1, "R",
     lambda m: m.support.per_minute_kw),
    ("headroom", "Headroom kept", "kWh", 1, "R", lambda m: m.headroom.headroom_kwh),
    ("mean-headroom", "Headroom kept, mean", "kW", 1, "R", lambda m: m.headroom.mean_headroom_kw),
    ("ancillary-potential", "Ancillary potential", "kWh", 1, "R",
     lambda m: m.headroom.ancillary_potential_kwh),
    ("rise", "Largest rise", "kW/min", 1, "R", _ramp("largest_up_kw_per_min")),
    ("fall", "Largest fall", "kW/min", 1, "R", _ramp("largest_down_kw_per_min")),
    ("ramp", "Largest ramp", "kW/min", 0, "S", _ramp("largest_kw_per_min")),
    ("ramp-limit", "Ramp limit", "kW/min", 0, "R", _ramp("limit_kw_per_min")),
    ("above-ramp-limit", "Minutes above the ramp limit", "%", 2, "SR",
     _ramp("above_limit_percent")),
)
_REGULATION: Final[tuple[_Row, ...]] = (
    ("capacity", "Regulation capacity", "kW", 0, "R", _regulation("capacity_kw")),
    ("offered", "Regulation offered", "h", 2, "R", _regulation("offered_h")),
    ("signal-mileage", "Mileage of the signal", "1/h", 2, "R",
     _regulation("signal_mileage_per_hour")),
    ("regd-strict", "Requests fulfilled to 0.1 %", "%", 2, "SRC+",
     _requests(0, "fulfilled_percent")),
    ("regd", "Requests fulfilled to 1 %", "%", 2, "SRCD+", _requests(1, "fulfilled_percent")),
    ("regd-feasible-strict", "Feasible requests fulfilled to 0.1 %", "%", 2, "RC+",
     _requests(0, "feasible_fulfilled_percent")),
    ("regd-feasible", "Feasible requests fulfilled to 1 %", "%", 2, "RC+",
     _requests(1, "feasible_fulfilled_percent")),
    ("accuracy", "Accuracy", "", 3, "RC+", _score("accuracy")),
    ("delay", "Delay", "", 3, "RC+", _score("delay")),
    ("precision", "Precision", "", 3, "RC+", _score("precision")),
    ("score", "PJM performance score", "", 3, "SRCD+", _score("score")),
    ("score-unclipped", "PJM score, accuracy not clipped", "", 3, "RC+",
     _score("unclipped_score")),
)
# fmt: on

_GROUPS: Final[dict[Group, tuple[_Row, ...]]] = {
    "commitment": _COMMITMENT,
    "regulation": _REGULATION,
}
FIGURES_OF_MERIT: Final = {
    name: FigureOfMerit(
        name,
        title,
        unit,
        decimals,
        group,
        frozenset(_PLACES[letter] for letter in places.rstrip("+")),
        places.endswith("+"),
        read,
    )
    for group, rows in _GROUPS.items()
    for name, title, unit, decimals, places, read in rows
}
"""All figures of merit by name, in the order in which tables show them."""


def shown_in(place: Place, group: Group | None = None) -> tuple[FigureOfMerit, ...]:
    """Return the figures that are shown at a place, of one group or of both."""
    return tuple(
        figure
        for figure in FIGURES_OF_MERIT.values()
        if place in figure.places and group in (None, figure.group)
    )


def figures_json(metrics: RunMetrics) -> dict[str, float | None]:
    """Return all figures of merit of a run by name."""
    return {name: figure.read(metrics) for name, figure in FIGURES_OF_MERIT.items()}


def runs_as_columns(
    title: str,
    runs: Sequence[tuple[str, RunMetrics]],
    figures: Sequence[FigureOfMerit],
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
    return Table(title, columns, tuple(rows))
