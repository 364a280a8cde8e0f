"""The notebook runs as it is, from its launch to its plots."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import python
from running import REPOSITORY

NOTEBOOK = REPOSITORY / "examples" / "first_look.ipynb"

RUN = """
import ast, json, os, sys
names = {}
for cell in json.load(open(sys.argv[1], encoding="utf-8"))["cells"]:
    if cell["cell_type"] == "code":
        *before, last = ast.parse("".join(cell["source"])).body
        exec(compile(ast.Module(before, []), "cell", "exec"), names)
        shown = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
        traces = [len(one.y if one.y is not None else one.z) for one in getattr(shown, "data", ())]
        print(type(shown).__name__, *traces)
print(shown)
"""
"""Runs each cell, and says what kind of thing it shows; of a plot, how many values."""


@pytest.mark.processes
def test_every_cell_runs_and_shows_what_it_says(tmp_path: Path) -> None:
    lines = python(RUN, NOTEBOOK, cwd=tmp_path).stdout.splitlines()
    run, table, plant, power, helped, equal, shown = lines
    assert (run, table, equal, shown) == ("Run", "DataFrame", "bool", "True")
    assert plant == "Figure" + " 180" * 7
    assert power == "Figure" + " 180" * 17
    assert int(helped.split()[1]) > 1


def test_the_notebook_is_kept_without_outputs() -> None:
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert not [cell for cell in cells if cell.get("outputs") or cell.get("execution_count")]
