"""A layout of panels for Foxglove and Lichtblick that fits the topics of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import COMMAND, DISPATCH, IMPP, PRODUCTION, SETPOINT, TELEMETRY, Port
from bus_schemas.tree import ROOT

_MOST_LINES: Final = 20
_SHOWN_S: Final = 300


def viewer_layout(plan: RunPlan) -> dict[str, object]:
    """Return a layout: the plant's power, its clusters, and the first inverter."""
    tree = plan.tree
    clusters = tree.children(ROOT)[:_MOST_LINES]
    inverter = tree.leaves[0]

    def value(port: Port[Message], field: str = "power_kw") -> str:
        return f"{plan.wiring.key(port)}.{field}"

    panels = {
        "Plant power [kW]": {
            "available": value(PRODUCTION.of(ROOT), "available_kw"),
            "dispatch": value(DISPATCH.of(ROOT)),
            "delivered": value(PRODUCTION.of(ROOT), "delivered_kw"),
        },
        "IMPP of the clusters [kW]": {node: value(IMPP.of(node)) for node in clusters},
        "Setpoints of the clusters [kW]": {node: value(SETPOINT.of(node)) for node in clusters},
        f"{inverter} [kW]": {
            "IMPP": value(IMPP.of(inverter)),
            "setpoint": value(SETPOINT.of(inverter)),
            "delivered": value(TELEMETRY.of(inverter)),
        },
        f"{inverter}, alpha": {"alpha": value(COMMAND.of(inverter), "alpha")},
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


def _plot(title: str, lines: Mapping[str, str]) -> dict[str, object]:
    """Return a panel with a line for each label, and the path of its value in a message."""
    return {
        "foxglovePanelTitle": title,
        "paths": [
            {"value": path, "label": label, "enabled": True, "timestampMethod": "receiveTime"}
            for label, path in lines.items()
        ],
        "minYValue": 0,
        "xAxisVal": "timestamp",
        "followingViewWidth": _SHOWN_S,
        "isSynced": True,
        "showLegend": True,
    }


def _column(first: object, second: object) -> dict[str, object]:
    return {"direction": "column", "first": first, "second": second}
