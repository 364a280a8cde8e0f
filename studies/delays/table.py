"""The tables of a study of delay and loss in a terminal, and what is to be known beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import takewhile
from typing import Final, get_args

from rich.console import Console

from agents.plan import Scheme
from launch_scripts.scenarios.preparation import Preparation
from studies.compare.study import remarks_of
from studies.delays.study import VALUES, WARM_UP_S, Outcome, Trouble
from studies.timing.figure_tables import Column, FigureTable, print_table

BEARABLE_PERCENT: Final = 1.0
"""Control-caused shortfall, in % of desired, up to which a trouble counts as survived."""

TROUBLES: Final[dict[Trouble, tuple[str, str]]] = {
    "delay": ("every hop delayed", "delay of each hop [s]"),
    "loss": ("a share of all messages lost", "lost messages [%]"),
    "period": ("a slow central controller", "central period [s]"),
}
"""What each trouble is, and what it is measured by."""

MERITS: Final[dict[str, Callable[[Outcome], float | None]]] = {
    "control-caused [%]": lambda one: one.control_caused_percent,
    "over-delivered [%]": lambda one: one.over_delivered_percent,
    "mileage [kW/h]": lambda one: one.mileage_kw_per_h,
    "RegD fulfilled [%]": lambda one: one.fulfilled_percent,
    "PJM score": lambda one: one.score,
}
"""What a run is judged by."""

FIGURES: Final = (*MERITS, "absent [%]", "old inputs")
"""Headings of what is told of each run."""

_WIDTH: Final = 9
"""Of a column of figures, where there is room."""

_LEGEND: Final = (
    "control-caused, over-delivered: in % of the desired energy; RegD: requests fulfilled to 1 % "
    "of the rating; absent: inputs that were not there at their deadline, in % of all",
    "old inputs: older messages used in place of those",
    f"the first {WARM_UP_S:g} s of each run do not count",
)


def print_study(preparation: Preparation, outcomes: Sequence[Outcome], console: Console) -> None:
    """Print the tables, and how much of each trouble is survived."""
    for line in (study_title(preparation), *study_notes(preparation)):
        console.print(line, highlight=False)
    for trouble in VALUES:
        print_table(console, trouble_table(trouble, outcomes))
    for line in survived(outcomes):
        console.print(line, highlight=False)


def counted_s(preparation: Preparation) -> float:
    """Return how much of each run counts [s]."""
    plan = preparation.plan
    return plan.cycles * plan.cycle_ns / 1e9 - WARM_UP_S


def study_title(preparation: Preparation) -> str:
    """Return what was studied."""
    plan = preparation.plan
    length = f"{plan.cycles:,} cycles of {plan.cycle_ns / 1e9:g} s"
    return f"{plan.plant} from {preparation.local_start()}, {length}"


def study_notes(preparation: Preparation) -> tuple[str, ...]:
    """Say what is to be known besides the tables."""
    longest_s = counted_s(preparation) / 2.0
    too_long = (
        f"central periods above {longest_s:g} s are left out: of each run {2.0 * longest_s:g} s "
        "count, which do not hold two of them",
    )
    shorter = longest_s < max(VALUES.get("period", (0.0,)))
    return (*remarks_of(preparation), *_LEGEND, *(too_long if shorter else ()))


def column_of(outcomes: Sequence[Outcome], trouble: Trouble, scheme: str) -> list[Outcome]:
    """Return what a scheme comes to under a growing trouble."""
    return [one for one in outcomes if (one.trouble, one.scheme) == (trouble, scheme)]


def survived(outcomes: Sequence[Outcome]) -> list[str]:
    """Say, for each scheme, up to where each trouble costs less than 1 % of the desired energy."""
    return [
        f"{scheme}: the shortfall that control causes stays below {BEARABLE_PERCENT:g} % of the "
        "desired energy at " + ", ".join(_limits(outcomes, scheme))
        for scheme in get_args(Scheme)
    ]


def _limits(outcomes: Sequence[Outcome], scheme: Scheme) -> Iterator[str]:
    for trouble, (_, unit) in TROUBLES.items():
        column = column_of(outcomes, trouble, scheme)
        borne = [one.value for one in takewhile(_is_bearable, column)]
        name, _, in_unit = unit.partition(" [")
        yield f"{name} up to {borne[-1]:g} {in_unit[:-1]}" if borne else f"no {name}"


def _is_bearable(one: Outcome) -> bool:
    return one.control_caused_percent is not None and one.control_caused_percent < BEARABLE_PERCENT


def trouble_table(trouble: Trouble, outcomes: Sequence[Outcome]) -> FigureTable:
    """Return what each run under a trouble came to."""
    what, unit = TROUBLES[trouble]
    columns = [Column(_folded(heading), _WIDTH) for heading in FIGURES]
    rows = [
        (f"{one.value:g} {one.scheme}", *figures(one)) for one in outcomes if one.trouble == trouble
    ]
    return FigureTable(what, f": {unit}, scheme", columns, rows)


def _folded(heading: str) -> str:
    """Return a heading in short lines, its unit in the last one."""
    return heading.replace("-", "-\n").replace(" ", "\n")


def figures(one: Outcome) -> tuple[str, ...]:
    """Return what a run came to, in the order of `FIGURES`."""
    merits = (_text(name, read(one)) for name, read in MERITS.items())
    return (*merits, f"{one.missed_percent:.1f}", f"{one.old_inputs:,}")


def _text(merit: str, value: float | None) -> str:
    if value is None:
        return "-"
    decimals = {"mileage [kW/h]": 0, "RegD fulfilled [%]": 1}.get(merit, 3)
    return f"{value:,.{decimals}f}"
