"""The tables of docs/results.md."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Final

import pandas as pd
from tables import WORKERS, Lines, Tables, header, hope, plant, row

from heliarch import compare
from launch_scripts.scenarios.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenarios.scenario import ScenarioFile
from studies.arrays.closed_loop import run_loop
from studies.compare.cases import with_settings
from studies.metrics import commitment_metrics

BOTH: Final = ("fraction", "limit")
SHARES: Final = [0.5, 0.7, 0.8, 0.9]

COMMITMENT: Final = {
    "satisfied": ("satisfied %", 2),
    "shortfall-energy": ("unsatisfied kWh", 1),
    "unavoidable": ("unavoidable %", 3),
    "control-caused": ("control-caused %", 3),
    "over-delivered": ("over-delivered %", 2),
    "mileage": ("mileage kW/h", 0),
    "rmse": ("RMSE kW", 1),
}
REGULATION: Final = {
    "regd-strict": ("fulfilled to 0.1 %", 2),
    "regd": ("to 1 %", 2),
    "regd-feasible-strict": ("of the feasible, to 0.1 %", 2),
    "regd-feasible": ("to 1 %", 2),
    "score": ("PJM score", 3),
    "score-unclipped": ("not clipped", 3),
}
Figures = dict[str, tuple[str, int]]


def case_study(data: Path) -> Lines:
    """Write the paper's first table."""
    return by_scheme(_case_study(), COMMITMENT)


def case_study_regulation(data: Path) -> Lines:
    """Write the paper's second table."""
    return by_scheme(_case_study(), REGULATION)


@cache
def _case_study() -> pd.DataFrame:
    return compare("oahu-day", actuators=BOTH)


def headroom(data: Path) -> Lines:
    """Write both of the paper's tables by how much is held back."""
    schemes = ("grouping", "paper", "predictive", "physical-limit")
    found = compare(
        "oahu-day",
        schemes=schemes,
        actuators=["fraction"],
        settings={"commitment.share": [0.9, 0.8, 0.7]},
        workers=WORKERS,
    )
    figures = {
        "ancillary-potential": ("potential kWh", 0),
        **{name: COMMITMENT[name] for name in ("satisfied", "control-caused", "over-delivered")},
        "regd-feasible": ("RegD of the feasible, to 1 %", 2),
    }
    return by_scheme(found, figures, case=lambda label: f"{label.removeprefix('share=')}")


def skies(data: Path) -> Lines:
    """Write means and intervals over a hundred skies."""
    schemes = ("uniform-cap", "grouping", "paper", "predictive")
    found = compare("oahu", schemes=schemes, actuators=BOTH, seeds=range(1, 101), workers=WORKERS)
    yield from header(["scheme", "actuator", "control-caused %", "5 to 95 %", "over-delivered %"])
    for (scheme, actuator), group in found.groupby(["scheme", "actuator"], sort=False):
        missing, beyond = group["control-caused"], group["over-delivered"]
        yield row(
            [
                scheme,
                actuator,
                f"{missing.mean():.3f} ± {interval(missing):.3f}",
                f"{missing.quantile(0.05):.3f} to {missing.quantile(0.95):.3f}",
                f"{beyond.mean():.2f} ± {interval(beyond):.2f}",
            ]
        )


def interval(values: pd.Series[float]) -> float:
    """Half the width of a 95 % interval of the mean of a hundred values (Student's t)."""
    return float(1.984 * values.std() / len(values) ** 0.5)


def hope_schemes(data: Path) -> Lines:
    """Write all schemes on the HOPE hour."""
    return by_scheme(compare(hope(data), actuators=BOTH), COMMITMENT)


def hope_cells(data: Path) -> Lines:
    """Write the estimators on the HOPE hour, by share and noise."""
    return cells(hope(data), {})


def hour_cells(letter: str) -> Callable[[Path], Lines]:
    """Return what writes the estimators on an hour of the real plant, if its file is there."""
    currents = f"hour_{letter}.csv"

    def write(data: Path) -> Lines:
        if (data / "plant20mw-combiners-10s" / currents).exists():
            yield from cells(plant(data), {"irradiance.currents": [currents]})

    return write


def hours(data: Path) -> Lines:
    """Write all schemes on the hours of the real plant."""
    for letter in "abc":
        settings = {"irradiance.currents": [f"hour_{letter}.csv"]}
        found = compare(plant(data), actuators=BOTH, settings=settings)
        found["case"] = letter
        lines = list(by_scheme(found, COMMITMENT, case=str))
        yield from lines if letter == "a" else lines[2:]


def cycles(data: Path) -> Lines:
    """Write the two estimators by the length of a cycle."""
    settings: dict[str, Any] = {"time.cycle_s": [1, 10, 60], "plant.meter_noise": [0, 0.005]}
    found = compare(
        "oahu",
        schemes=("paper", "predictive"),
        actuators=BOTH,
        settings=settings,
        workers=WORKERS,
    )
    figures = {name: COMMITMENT[name] for name in ("control-caused", "over-delivered", "rmse")}
    return by_scheme(found, figures, case=str)


def floor(data: Path) -> Lines:
    """Write what margins make of hour a with limits, with and without hidden maxima."""
    yield from header(["what is known", "margin", "80%", "90%"])
    for known, stated in (
        ("readings of inverters, some held by a limit", ()),
        ("each maximum of the interval that ended", ("plant.available_bias=0",)),
    ):
        days = [
            prepare(
                with_settings(plant(data), [f"commitment.share={share}", *stated]),
                RunOptions(),
                "compare",
            )
            for share in (0.8, 0.9)
        ]
        for margin in (-0.5, 0.0, 0.5, 1.0):
            yield row([known, f"{margin:g}", *(pair(day, margin) for day in days)])
    yield row(["each maximum of the coming interval", "0", "0.000 (0.00)", "0.000 (0.00)"])


def pair(day: Preparation, margin: float) -> str:
    """Return control-caused and over-delivered of a day with limits and a margin."""
    found = run_loop(day.plan, day.profile, "predictive", "limit", {"MARGIN": margin})
    desired_kw = day.profile.commitment_kw + day.profile.regulation_kw
    totals = day.profile.mpp_kw.sum(axis=1), found.power_kw.sum(axis=1)
    energy = commitment_metrics(desired_kw, *totals, day.plan.cycle_ns / 1e9)
    percent = 100.0 / energy.desired_kwh
    missing, beyond = energy.control_caused_kwh, energy.over_delivered_kwh
    return f"{percent * missing:.3f} ({percent * beyond:.2f})"


# Tables -------------------------------------------------------------------------------------------


def by_scheme(
    found: pd.DataFrame, figures: Figures, case: Callable[[str], str] | None = None
) -> Lines:
    """Write a row for each scheme and actuator, after a column for the case if there are many."""
    found = found.fillna({"actuator": "-"})
    first = ["case"] if case else []
    yield from header([*first, "scheme", "actuator", *(title for title, _ in figures.values())])
    for _, entry in found.iterrows():
        numbers = [f"{entry[name]:,.{decimals}f}" for name, (_, decimals) in figures.items()]
        labels = [case(entry["case"])] if case else []
        yield row([*labels, entry["scheme"], entry["actuator"], *numbers])


def cells(scenario: ScenarioFile, settings: dict[str, Any]) -> Lines:
    """Write control-caused and over-delivered of each scheme by share, without and with noise."""
    settings = {"commitment.share": SHARES, "plant.meter_noise": [0, 0.005], **settings}
    schemes = ("uniform-cap", "grouping", "paper", "predictive")
    found = compare(scenario, schemes=schemes, actuators=BOTH, settings=settings, workers=WORKERS)
    found["noise"] = found["case"].str.contains("meter_noise=0.005")
    found["share"] = found["case"].str.extract(r"share=([\d.]+)", expand=False).astype(float)
    yield from header(["actuator", "scheme", *(f"{share:.0%}" for share in SHARES)])
    rows = found[found["scheme"] != "grouping worst"]
    rows = rows.sort_values(["actuator", "noise"], kind="stable")
    for (actuator, noise, scheme), group in rows.groupby(
        ["actuator", "noise", "scheme"], sort=False
    ):
        missing, beyond = (
            dict(zip(group["share"], group[name], strict=True))
            for name in ("control-caused", "over-delivered")
        )
        pairs = [f"{missing[share]:.3f} ({beyond[share]:.2f})" for share in SHARES]
        yield row([actuator, f"{scheme}, noise" if noise else scheme, *pairs])


FROM_SYNTHETIC: Final[Tables] = {
    "case study": case_study,
    "case study, regulation": case_study_regulation,
    "headroom": headroom,
    "skies": skies,
    "cycles": cycles,
}
FROM_DATA: Final[Tables] = {
    "HOPE": hope_schemes,
    "HOPE, estimators": hope_cells,
    **{f"hour {letter}, estimators": hour_cells(letter) for letter in "abcde"},
    "floor": floor,
    "hours": hours,
}
