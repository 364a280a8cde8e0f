"""Measured irradiance beside a clear sky, before a scenario runs on it: a page, or a picture."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from bus_schemas.errors import InputError
from bus_schemas.whole_file import whole_file
from results.report import style
from results.report.decimation import extremes
from results.report.page import html_page
from results.report.result import Result
from sim_plant.clear_sky import clear_ghi
from sim_plant.irradiance import Irradiance

_MOST_LINES = 20


def check_preview(path: Path) -> None:
    if path.suffix not in {".html", ".png"}:
        raise InputError.of("--preview", f"expected a file *.html or *.png, got {path}")


def write_preview(found: Irradiance, lines: Sequence[str], path: Path) -> None:
    """Draw the GHI of each station, and of a clear sky; `lines` say what the file holds."""
    curves = _curves(found)
    if path.suffix == ".png":
        _write_picture(curves, path)
        return
    title = f"Irradiance in {Path(found.source).name}"
    page = html_page(Result(title, (), {}, lines, figures=lambda: [_figure(curves)]))
    with whole_file(path) as file:
        file.write(page.encode())


def _curves(found: Irradiance) -> dict[str, pd.Series]:
    """Return some values of each line, thinned out for a screen, by its name."""
    clear = pd.Series(clear_ghi(found.times, found.coordinates), found.times)
    stations = {str(name): found.ghi_wm2[name] for name in found.ghi_wm2.columns[:_MOST_LINES]}
    every = {**stations, "clear sky": clear}
    return {name: line.iloc[np.sort(extremes(line.to_numpy()))] for name, line in every.items()}


def _figure(curves: dict[str, pd.Series]) -> style.ReportFigure:
    figure = go.Figure()
    for at, (name, line) in enumerate(curves.items()):
        look = (
            {"color": style.BLACK, "width": 1.5} if name == "clear sky" else style.scheme_line(at)
        )
        times = pd.DatetimeIndex(line.index).tz_localize(None)
        figure.add_trace(style.curve(times, line.to_numpy(), name, look))
    figure.update_yaxes(title_text="GHI [W/m²]")
    figure.update_xaxes(title_text="UTC")
    caption = "Above the clear sky only the edges of clouds are plausible, for minutes."
    dressed = style.dress(figure, 420)
    return style.ReportFigure("irradiance", "Irradiance", caption, dressed)


def _write_picture(curves: dict[str, pd.Series], path: Path) -> None:
    try:
        drawing = import_module("matplotlib.figure")  # Not every user has it.
    except ImportError:
        expected = "*.html, or matplotlib for a picture: pip install matplotlib"
        raise InputError.of("--preview", f"expected {expected}, got {path}") from None
    figure = drawing.Figure(figsize=(10, 4.2), layout="constrained")
    axes = figure.add_subplot()
    for name, line in curves.items():
        colour = "black" if name == "clear sky" else None
        axes.plot(pd.DatetimeIndex(line.index), line.to_numpy(), label=name, lw=1, color=colour)
    axes.set(ylabel="GHI [W/m²]", xlabel="UTC")
    figure.legend(loc="outside lower center", fontsize="small", ncols=11)
    with whole_file(path) as file:
        figure.savefig(file, format="png", dpi=120)
