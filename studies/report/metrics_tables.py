"""The report's tables of figures of merit: one row for each, the runs side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, TypeAlias, TypeVar

from recordings.read.series import RunSeries
from studies.metrics import (
    CommitmentMetrics,
    HeadroomMetrics,
    PerformanceScore,
    RampMetrics,
    RegulationMetrics,
    RunMetrics,
    SupportMileage,
    TrackingError,
    run_metrics,
)
from studies.report.tables import ReportTable

Part = TypeVar("Part")
Rows: TypeAlias = tuple[tuple[str, str, int, Callable[[Part], float | None]], ...]
"""Of each figure of merit its name, its unit, the decimals to show and where it is."""

NOT_DEFINED: Final = "-"

_COMMITMENT: Final[Rows[CommitmentMetrics]] = (
    ("Desired energy", "kWh", 1, lambda part: part.desired_kwh),
    ("Possible energy", "kWh", 1, lambda part: part.possible_kwh),
    ("Delivered energy", "kWh", 1, lambda part: part.delivered_kwh),
    ("Satisfied commitment", "%", 3, lambda part: part.satisfied_percent),
    ("Unsatisfied commitment", "kWh", 2, lambda part: part.unsatisfied_kwh),
    ("Unsatisfied, unavoidable part", "kWh", 2, lambda part: part.unavoidable_kwh),
    ("Unsatisfied, part caused by control", "kWh", 2, lambda part: part.control_caused_kwh),
    ("Delivered beyond desired", "kWh", 2, lambda part: part.over_delivered_kwh),
)
_TRACKING: Final[Rows[TrackingError]] = (
    ("Root mean square error", "kW", 2, lambda part: part.rmse_kw),
    ("Mean absolute error", "kW", 2, lambda part: part.mae_kw),
)
_SUPPORT: Final[Rows[SupportMileage]] = (
    ("Mileage of the support power, whole run", "kW", 0, lambda part: part.total_kw),
    ("Mileage of the support power, per hour", "kW/h", 0, lambda part: part.per_hour_kw),
    ("Mileage of the support power, per minute", "kW/min", 1, lambda part: part.per_minute_kw),
)
_HEADROOM: Final[Rows[HeadroomMetrics]] = (
    ("Headroom kept", "kWh", 1, lambda part: part.headroom_kwh),
    ("Headroom kept, mean", "kW", 1, lambda part: part.mean_headroom_kw),
    ("Ancillary potential", "kWh", 1, lambda part: part.ancillary_potential_kwh),
)
_RAMPS: Final[Rows[RampMetrics]] = (
    ("Largest rise", "kW/min", 1, lambda part: part.largest_up_kw_per_min),
    ("Largest fall", "kW/min", 1, lambda part: part.largest_down_kw_per_min),
)
_RAMP_LIMIT: Final[Rows[RampMetrics]] = (
    ("Ramp limit", "kW/min", 0, lambda part: part.limit_kw_per_min),
    ("Minutes above the ramp limit", "%", 2, lambda part: part.above_limit_percent),
)
_REGULATION: Final[Rows[RegulationMetrics]] = (
    ("Regulation capacity", "kW", 0, lambda part: part.capacity_kw),
    ("Regulation offered", "h", 2, lambda part: part.offered_h),
    ("Mileage of the signal", "1/h", 2, lambda part: part.signal_mileage_per_hour),
)
_SCORE: Final[Rows[PerformanceScore]] = (
    ("Performance score", "", 3, lambda part: part.score),
    ("Score of accuracy", "", 3, lambda part: part.accuracy),
    ("Score of delay", "", 3, lambda part: part.delay),
    ("Score of precision", "", 3, lambda part: part.precision),
)


def metrics_tables(series: Sequence[RunSeries]) -> list[ReportTable]:
    """Return the tables of figures of merit: how the commitment was kept, and regulation if any.

    Parameters
    ----------
    series
        The runs, one column each; one or more, each with one cycle or more.
    """
    found = [run_metrics(one) for one in series]
    columns = tuple(one.label for one in series)
    tables = [_commitment_table(columns, found)]
    if any(one.regulation for one in found):
        tables.append(_regulation_table(columns, [one.regulation for one in found]))
    return tables


def _commitment_table(columns: tuple[str, ...], found: Sequence[RunMetrics]) -> ReportTable:
    return ReportTable(
        "How the commitment was kept",
        columns,
        (
            *_filled(_COMMITMENT, [one.commitment for one in found]),
            *_filled(_TRACKING, [one.tracking for one in found]),
            *_filled(_SUPPORT, [one.support for one in found]),
            *_filled(_HEADROOM, [one.headroom for one in found]),
            *_filled(_RAMPS, [one.ramps for one in found]),
            *(_filled(_RAMP_LIMIT, [one.ramps for one in found]) if _is_limited(found) else ()),
        ),
        "Unavoidable is what no controller could have met, since less was possible than was "
        "desired. Support power is max(0, desired - delivered). Errors are of delivered against "
        "desired power; rises and falls are those of the delivered power within a minute.",
    )


def _is_limited(found: Sequence[RunMetrics]) -> bool:
    return any(one.ramps and one.ramps.limit_kw_per_min is not None for one in found)


def _regulation_table(
    columns: tuple[str, ...], found: Sequence[RegulationMetrics | None]
) -> ReportTable:
    tolerances = next([each.tolerance_percent for each in one.requests] for one in found if one)
    fulfilled: Rows[RegulationMetrics] = tuple(
        (f"Requests fulfilled to {percent:g} % of the rating", "%", 2, _fulfilled(place))
        for place, percent in enumerate(tolerances)
    )
    return ReportTable(
        "How the regulation signal was followed",
        columns,
        (
            *_filled(_REGULATION, found),
            *_filled(fulfilled, found),
            *_filled(_SCORE, [one.performance if one else None for one in found]),
        ),
        "A request lasts 2 s, or a cycle where that is longer. The score is PJM's, from 0 to 1; "
        "0.75 passes.",
    )


def _fulfilled(place: int) -> Callable[[RegulationMetrics], float]:
    return lambda part: part.requests[place].fulfilled_percent


def _filled(
    rows: Rows[Part], parts: Sequence[Part | None]
) -> list[tuple[str, str, tuple[str, ...]]]:
    """Return rows as text, one value for each run, or a hyphen where it does not define it."""
    return [
        (
            name,
            unit,
            tuple(_as_text(None if part is None else value(part), decimals) for part in parts),
        )
        for name, unit, decimals, value in rows
    ]


def _as_text(value: float | None, decimals: int) -> str:
    return NOT_DEFINED if value is None else f"{value:,.{decimals}f}"
