"""A node's timeline says of each cycle what was measured, asked and given, and for whom."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace
from recordings_by_hand import PLAN, cycle_of_the_plant, whole_run, write_run

from bus_schemas.bus import Delivery
from bus_schemas.messages import Dispatch, Notice
from bus_schemas.signals import IMPP, NOTICE, TELEMETRY
from bus_schemas.tree import ROOT
from recordings.inspect.timeline import NodeCycle, timeline
from recordings.read.reader import RunReader
from results.timeline_tables import node_table, plant_table


def rows_of(path: Path, node: str, cycles: range) -> list[NodeCycle]:
    with RunReader(path) as run:
        return [row for rows in timeline(run, [node], cycles) for row in rows]


def written(folder: Path, deliveries: Iterable[Delivery]) -> Path:
    path = folder / "run.mcap"
    write_run(path, deliveries)
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("timeline"), whole_run(30))


def test_an_inverter_without_enough_power_asks_for_help_and_hears_from_whom(
    recording: Path,
) -> None:
    (row,) = rows_of(recording, "c1/a", range(10, 11))
    assert row.document() == {
        "cycle": 10,
        "time": "12:00:10",
        "node": "c1/a",
        "power_kw": 53.0,
        "impp_kw": 40.0,
        "stale_cycles": 0,
        "share_kw": 60.0,
        "residual_kw": -20.0,
        "help_asked_kw": 20.0,
        "help_from": [{"node": "c1/b", "power_kw": 20.0}],
        "setpoint_kw": 40.0,
        "alpha": 0.8,
    }


def test_the_central_controller_has_the_dispatch_and_the_plant_s_production(
    recording: Path,
) -> None:
    (row,) = rows_of(recording, ROOT, range(10, 11))
    assert (row.node, row.needy) == ("central", [])
    expected_kw = {"dispatch": 240.0, "commitment": 230.0, "share": 240.0, "available": 280.0}
    expected_kw |= {"delivered": 239.0}
    assert {name: row.values[f"{name}_kw"] for name in expected_kw} == expected_kw


def test_the_central_controller_has_the_orders_in_the_cycles_in_which_they_change(
    tmp_path: Path,
) -> None:
    def ordered(cycle: int) -> Iterable[Delivery]:
        for port, message in cycle_of_the_plant(cycle):
            order: dict[str, Any] = {}
            if isinstance(message, Dispatch) and cycle >= 2:
                order = {"order_source": "operator", "order_cycle": 2, "order_power_kw": 150.0}
                order["order_state"] = "silent" if cycle >= 4 else "holds"
            yield port, replace(message, **order)

    path = written(tmp_path, (pair for cycle in range(6) for pair in ordered(cycle)))
    notices = [row.notices for row in rows_of(path, ROOT, range(6))]
    said = ["operator orders 150 kW"], ["operator silent: its order is not renewed"]
    assert notices == [[], [], said[0], [], said[1], []]
    later = [row.notices for row in rows_of(path, ROOT, range(3, 6))]
    assert later == [[], said[1], []], "an order that came before is no event"


def test_missing_inputs_and_notices_of_a_node_are_in_its_row(tmp_path: Path) -> None:
    def deaf(pair: Delivery) -> Delivery:
        port, message = pair
        if port.signal is IMPP and port.node == "c1/a":
            message = replace(message, missing=("c1/a/telemetry",), stale_cycles=2)
        return port, message

    deliveries = [
        deaf(pair) for pair in cycle_of_the_plant(0) if pair[0] is not TELEMETRY.of("c1/a")
    ]
    notice = Notice(
        0, PLAN.timing.sim_time_ns(0), "c1/a", (), text="no usable measurement", count=1
    )
    path = written(tmp_path, [*deliveries, (NOTICE.of("c1/a"), notice)])
    (row,) = rows_of(path, "c1/a", range(1))
    assert "power_kw" not in row.values
    assert row.values["stale_cycles"] == 2
    assert (row.missing, row.notices) == (["c1/a/telemetry"], ["no usable measurement"])
    (cells,) = node_table(PLAN.tree, "c1/a", [row]).texts()
    assert cells[:4] == ("0", "12:00:00", "-", "40.0")
    assert cells[-1].startswith("from b 20.0; stale for 2;")


# As tables ----------------------------------------------------------------------------------------


def test_the_plant_in_one_cycle_is_a_tree_of_all_its_nodes(recording: Path) -> None:
    with RunReader(recording) as run:
        (rows,) = timeline(run, PLAN.tree.nodes, range(10, 11))
    names, *_, remarks = zip(*plant_table(PLAN.tree, "", rows).texts(), strict=True)
    assert names == ("central", "├─ c1", "│  ├─ a", "│  └─ b", "└─ c2", "   ├─ c", "   └─ d")
    assert remarks[1:4] == ("need: a", "from b 20.0", "for a 20.0")
