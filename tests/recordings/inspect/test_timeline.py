"""A node's timeline says of each cycle what was measured, asked and given, and for whom."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest
from msgspec.structs import replace
from recordings_by_hand import PLAN, cycle_of_the_plant, whole_run, write_run

from bus_schemas.bus import Delivery
from bus_schemas.messages import Notice
from bus_schemas.signals import IMPP, NOTICE, TELEMETRY
from bus_schemas.tree import ROOT
from recordings import open_run
from recordings.inspect.timeline import (
    HelpLine,
    NodeCycle,
    heading,
    node_columns,
    plant_lines,
    row_text,
    timeline,
)


def rows_of(path: Path, node: str, cycles: range) -> list[NodeCycle]:
    with open_run(path) as run:
        return [row for rows in timeline(run, [node], cycles) for row in rows]


def written(folder: Path, deliveries: Iterable[Delivery]) -> Path:
    path = folder / "run.mcap"
    write_run(path, deliveries)
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("timeline"), whole_run(30))


def test_who_lacks_power_asks_for_help_and_is_told_who_gives_it(recording: Path) -> None:
    (row,) = rows_of(recording, "c1/a", range(10, 11))
    assert row == NodeCycle(
        10,
        "12:00:10",
        "c1/a",
        power_kw=53.0,
        impp_kw=40.0,
        request_kw=60.0,
        residual_kw=-20.0,
        help_asked_kw=20.0,
        help_from=[HelpLine("c1/b", 20.0)],
        setpoint_kw=40.0,
        alpha=0.8,
    )


def test_a_supervisor_knows_who_is_in_need_and_what_it_moved(recording: Path) -> None:
    acting, between = rows_of(recording, "c1", range(10, 12))
    assert (acting.needy, acting.moved_kw) == (["c1/a"], 20.0)
    assert (acting.request_kw, acting.setpoint_kw) == (120.0, 120.0)
    assert (between.request_kw, between.setpoint_kw) == (120.0, None), "not its parent's turn"
    assert between.moved_kw == 20.0


def test_the_central_controller_has_the_operators_word_and_what_came_of_it(recording: Path) -> None:
    (row,) = rows_of(recording, ROOT, range(10, 11))
    assert (row.node, row.dispatch_kw, row.commitment_kw) == ("central", 240.0, 230.0)
    assert row.request_kw == 240.0
    assert (row.possible_kw, row.delivered_kw, row.needy) == (280.0, 239.0, [])


def test_messages_out_of_the_order_of_cycles_are_told_in_it(tmp_path: Path) -> None:
    order = [1, 0, 3, 2, 4]
    path = written(tmp_path, (pair for cycle in order for pair in cycle_of_the_plant(cycle)))
    rows = rows_of(path, "c1/a", range(5))
    assert [(row.cycle, row.power_kw) for row in rows] == [(n, 50.0 + n) for n in range(5)]


def test_what_a_node_had_to_do_without_and_said_in_words_is_rows_of(tmp_path: Path) -> None:
    def deaf(pair: Delivery) -> Delivery:
        port, message = pair
        if port.signal is IMPP and port.node == "c1/a":
            message = replace(message, missing=("c1/a/telemetry",), stale_cycles=2)
        return port, message

    deliveries = [
        deaf(pair) for pair in cycle_of_the_plant(0) if pair[0] is not TELEMETRY.of("c1/a")
    ]
    notice = Notice(0, PLAN.sim_time_ns(0), "c1/a", (), text="no usable measurement", count=1)
    path = written(tmp_path, [*deliveries, (NOTICE.of("c1/a"), notice)])
    (row,) = rows_of(path, "c1/a", range(1))
    assert (row.power_kw, row.stale_cycles) == (None, 2)
    assert (row.missing, row.notices) == (["c1/a/telemetry"], ["no usable measurement"])
    line = " ".join(row_text(node_columns(PLAN.tree, "c1/a", 8), row).split())
    assert line.startswith("0 12:00:00 - 40.00 60.00 -20.00 20.00 40.00 0.8000 from b 20.00;")


# As text ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("node", ["c1/a", "c1/b", "c1", ROOT])
def test_columns_keep_their_places(recording: Path, node: str) -> None:
    columns = node_columns(PLAN.tree, node, 12)
    names = heading(columns)
    for row in rows_of(recording, node, range(20)):
        line = row_text(columns, row)
        for name, value in (("IMPP", row.impp_kw), ("residual", row.residual_kw)):
            end = names.index(name) + len(name)
            assert line[:end].split()[-1] == f"{value:.2f}"


def test_the_plant_in_one_cycle_is_a_tree_of_all_its_nodes(recording: Path) -> None:
    with open_run(recording) as run:
        (rows,) = timeline(run, PLAN.tree.nodes, range(10, 11))
    lines = list(plant_lines(PLAN.tree, rows))[1:]
    assert [line[:6].rstrip() for line in lines] == [
        "centra",
        "├─ c1",
        "│  ├─",
        "│  └─",
        "└─ c2",
        "   ├─",
        "   └─",
    ]
    assert "from b 20.00" in lines[2]
    assert "for a 20.00" in lines[3]
    assert "need: a" in lines[1]
