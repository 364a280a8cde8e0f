"""A layout of panels for Foxglove and Lichtblick that fits the topics of a run."""

from __future__ import annotations

from typing import Final, TypeAlias

from agents.plan import RunPlan
from bus_schemas.signals import COMMAND, DISPATCH, IMPP, PRODUCTION, SETPOINT, TELEMETRY
from bus_schemas.tree import ROOT

Line: TypeAlias = tuple[str, str]
"""Label, and the path of the value in a message."""

_MOST_LINES: Final = 20
_SHOWN_S: Final = 300


def viewer_layout(plan: RunPlan) -> dict[str, object]:
    """Return a layout: the plant's power, its clusters, and the first inverter."""
    key, tree = plan.wiring.key, plan.tree
    clusters = tree.children(ROOT)[:_MOST_LINES]
    inverter = tree.leaves[0]
    made = key(PRODUCTION.of(ROOT))
    panels = {
        "Plant power [kW]": [
            ("possible", f"{made}.possible_kw"),
            ("desired", f"{key(DISPATCH.of(ROOT))}.power_kw"),
            ("delivered", f"{made}.delivered_kw"),
        ],
        "IMPP of the clusters [kW]": [
            (node, f"{key(IMPP.of(node))}.power_kw") for node in clusters
        ],
        "Setpoints of the clusters [kW]": [
            (node, f"{key(SETPOINT.of(node))}.power_kw") for node in clusters
        ],
        f"{inverter} [kW]": [
            ("IMPP", f"{key(IMPP.of(inverter))}.power_kw"),
            ("setpoint", f"{key(SETPOINT.of(inverter))}.power_kw"),
            ("delivered", f"{key(TELEMETRY.of(inverter))}.power_kw"),
        ],
        f"{inverter}, alpha": [("alpha", f"{key(COMMAND.of(inverter))}.alpha")],
    }
    ids = [f"Plot!panel{number}" for number in range(len(panels))]
    plots = zip(ids, panels.items(), strict=True)
    return {
        "configById": {name: _plot(title, lines) for name, (title, lines) in plots},
        "layout": {
            "direction": "row",
            "first": _column(ids[0], _column(ids[1], ids[2])),
            "second": _column(ids[3], ids[4]),
            "splitPercentage": 60,
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
    }


def _plot(title: str, lines: list[Line]) -> dict[str, object]:
    return {
        "foxglovePanelTitle": title,
        "paths": [
            {"value": path, "label": label, "enabled": True, "timestampMethod": "receiveTime"}
            for label, path in lines
        ],
        "minYValue": 0,
        "xAxisVal": "timestamp",
        "followingViewWidth": _SHOWN_S,
        "isSynced": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "sidebarDimension": 240,
    }


def _column(first: object, second: object) -> dict[str, object]:
    return {"direction": "column", "first": first, "second": second}
