"""Each top folder imports only from those above it in the list of docs/design.md.

The list of layers in pyproject.toml is what import-linter enforces. This adds what a linter does
not see: modules that are named in strings, as `python -m` and lazy loading have them.
"""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
CONTRACTS = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["importlinter"]
ROOMS: list[str] = CONTRACTS["contracts"][0]["layers"][::-1]
"""The top folders, from the one that imports none of the others."""

STARTED_BY = {"SideProcess", "import_module", "run_module"}
"""What is given the name of a module that it starts or loads."""


def test_the_rooms_are_whole_folders_and_all_of_them_in_the_order_of_the_documents() -> None:
    assert set(ROOMS) == {path.parent.name for path in REPOSITORY.glob("*/__init__.py")}
    assert CONTRACTS["contracts"][0].get("ignore_imports", []) == []
    text = (REPOSITORY / "docs" / "design.md").read_text(encoding="utf-8")
    listed = re.findall(r"^ *(\w+)/", text.split("## The house")[1].split("```")[1], re.MULTILINE)
    assert [name for name in listed if name in ROOMS] == ROOMS


@pytest.mark.parametrize("room", ROOMS)
def test_no_string_names_a_module_of_a_room_below(room: str) -> None:
    below = set(ROOMS[ROOMS.index(room) + 1 :])
    wrong = [
        f"{path.relative_to(REPOSITORY)}: {name}"
        for path in sorted((REPOSITORY / room).rglob("*.py"))
        for name in named_modules(path.read_text(encoding="utf-8"))
        if name.split(".")[0] in below
    ]
    assert wrong == []


def test_strings_that_name_modules_are_seen() -> None:
    assert named_modules('run(["python", "-m", "live_page"])') == ["live_page"]
    assert named_modules('import_module(f"heliarch.cli.{name}")') == ["heliarch.cli."]
    assert named_modules('"""Started by `studies.workers`."""; path / "recordings"') == []


def named_modules(code: str) -> list[str]:
    """Return the strings of a file that name a module of the house."""
    nodes = list(ast.walk(ast.parse(code)))
    texts = [str(one.value) for one in nodes if isinstance(one, ast.Constant)]
    names = {one.id for one in nodes if isinstance(one, ast.Name)}
    starts_one = "-m" in texts or STARTED_BY & names
    return [text for text in texts if is_module(text) or (starts_one and text in ROOMS)]


def is_module(text: str) -> bool:
    """Whether a text with dots is the name of a module, or the beginning of one."""
    room, *inner = text.rstrip(".").split(".")
    path = REPOSITORY.joinpath(room, *inner)
    return room in ROOMS and "." in text and (path.is_dir() or path.with_suffix(".py").exists())
