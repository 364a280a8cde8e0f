"""The processes of a run, as a list, before any of them is started."""

from __future__ import annotations

from pathlib import Path

from bus_schemas.tree import ControlTree
from launch_scripts.processes import processes


def test_no_two_agents_write_into_one_log_file() -> None:
    tree = ControlTree((("a-b", 1.0), ("a/b", 1.0), ("a_b", 1.0), ("a/b-c", 1.0), ("a-b-c", 1.0)))
    names = [spec.log_name for spec in processes(tree, Path("plan.json"))]
    assert len(set(names)) == len(names) == len(tree.agents())
    assert {"a-b.log", "a.b.log", "a_b.log"} <= set(names)
    assert not any("/" in name for name in names)
