"""A layout for Foxglove and Lichtblick: the plant's power, the clusters' setpoints, the notices.

`Layout`, `Import from file` in the viewer reads it; it has the form that the viewers export.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from agents.plan import RunPlan
from bus_schemas.signals import DISPATCH, NOTICE, PRODUCTION, SETPOINT, Port
from bus_schemas.tree import ROOT


def layout_path(file: Path) -> Path:
    """Return where the layout of a file for viewers stands: beside `run.json.mcap`."""
    return file.with_name(f"{file.name.removesuffix('.mcap').removesuffix('.json')}.foxglove.json")


def layout(plan: RunPlan, ports: Collection[Port[Any]]) -> dict[str, object]:
    """Return a layout of those of its topics that are among some ports."""
    of_root = [node for node in plan.tree.nodes if node != ROOT and "/" not in node]
    plots: dict[str, list[tuple[Port[Any], str]]] = {
        "Power of the plant [kW]": [
            (DISPATCH.of(ROOT), "power_kw"),
            (PRODUCTION.of(ROOT), "available_kw"),
            (PRODUCTION.of(ROOT), "delivered_kw"),
        ],
        "Setpoints [kW]": [(SETPOINT.of(node), "power_kw") for node in of_root],
    }
    panels: dict[str, dict[str, object]] = {}
    for number, (title, lines) in enumerate(plots.items()):
        there = [(port, field) for port, field in lines if port in ports]
        if there:
            paths = [_path(f"{_topic(plan, port)}.{field}") for port, field in there]
            panels[f"Plot!heliarch{number}"] = {
                "title": title,
                "paths": paths,
                "xAxisVal": "timestamp",
                "showLegend": True,
                "isSynced": True,
            }
    messages: tuple[Port[Any], ...] = NOTICE.of(ROOT), DISPATCH.of(ROOT)
    for port in messages:
        if port in ports:
            topic = _topic(plan, port)
            panels[f"RawMessages!heliarch{port.signal.name}"] = {"topicPath": topic}
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "layout": _stacked(iter(panels)),
    }


def _topic(plan: RunPlan, port: Port[Any]) -> str:
    """Return a topic as viewers read it in a path: in quotes where it has a hyphen."""
    key = plan.wiring.key(port)
    return f'"{key}"' if "-" in key else key


def _path(value: str) -> dict[str, object]:
    return {"value": value, "enabled": True, "timestampMethod": "receiveTime"}


def _stacked(panels: Iterator[str]) -> object:
    """Put panels below each other; None: there is none."""
    first = next(panels, None)
    rest = _stacked(panels) if first is not None else None
    return first if rest is None else {"direction": "column", "first": first, "second": rest}
