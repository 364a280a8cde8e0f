"""The study of clusters as one HTML page, with its figure."""

from __future__ import annotations

from dataclasses import replace
from statistics import fmean

import plotly.graph_objects as go

from studies.clusters.study import (
    ClusterStudy,
    clusters_table,
    members_table,
    orders_table,
    study_lines,
)
from studies.report.page import html_page
from studies.report.style import BLACK, SCHEMES, ReportFigure, dress


def study_page(study: ClusterStudy) -> str:
    """Return the page: what was run, the figure, the table, and how clusters were found."""
    paragraphs = [f"{study.title}.", *study.remarks, *study_lines(study)]
    return html_page(
        "Virtual neighbours and other clusters",
        paragraphs,
        [
            _shortfall_figure(study),
            replace(clusters_table(study), title="Ways to choose clusters"),
            orders_table(study),
            members_table(study),
        ],
    )


def _shortfall_figure(study: ClusterStudy) -> ReportFigure:
    """Draw the control-caused shortfall of each way to choose clusters, period by period."""
    figure = go.Figure()
    for colour, (name, worths) in zip(SCHEMES, study.ways.items(), strict=False):
        of_period = list(
            zip(
                *([one.control_caused_percent for one in worth.shortfalls] for worth in worths),
                strict=True,
            )
        )
        means = [fmean(values) for values in of_period]
        figure.add_trace(
            go.Bar(
                x=[f"{period_s:g} s" for period_s in study.periods_s],
                y=means,
                name=name,
                marker={"color": colour},
                error_y={
                    "type": "data",
                    "symmetric": False,
                    "array": [max(v) - mean for v, mean in zip(of_period, means, strict=True)],
                    "arrayminus": [mean - min(v) for v, mean in zip(of_period, means, strict=True)],
                    "color": BLACK,
                    "thickness": 1.2,
                    "visible": len(worths) > 1,
                },
                hovertemplate="%{y:.4f} %",
            )
        )
    figure = dress(figure, 380)
    figure.update_layout(barmode="group", bargap=0.3)
    figure.update_xaxes(type="category", title_text="the central controller acts every")
    figure.update_yaxes(title_text="control-caused shortfall [% of desired]", rangemode="tozero")
    return ReportFigure(
        "shortfall",
        "What a slow central controller costs",
        "Shortfall that control caused, in % of the desired energy. Random clusters: their mean, "
        "with a line from the least to the most.",
        figure,
    )
