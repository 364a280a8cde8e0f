"""Every command in the documents runs; one that is too long for a test has options that exist."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import cast

import pytest
import typer
import typer.core
import typer.main
from documents import DOCUMENTS, REPOSITORY, Block, blocks_of, heliarch_lines, words_of

from bus_schemas.errors import InputError
from launch_scripts.cli import app

USAGE_ERROR = cast(
    type[Exception], typer.BadParameter.__mro__[1]
)  # no such command, no such option
NAMES = [str(path.relative_to(REPOSITORY)) for path in DOCUMENTS]
_STARTS_PROCESSES = re.compile(r"heliarch (launch|timing|replay)")


def runnable(document: Path) -> list[Block]:
    return [
        block for block in blocks_of(document) if block.commands.strip() and block.mark != "not run"
    ]


def marks(document: Path) -> list[pytest.MarkDecorator]:
    text = "".join(block.commands for block in runnable(document))
    return [pytest.mark.processes] if _STARTS_PROCESSES.search(text) else []


@pytest.fixture
def reader(tmp_path: Path) -> Path:
    """Make a folder as a reader has it: `heliarch` and `python` on the path, the examples."""
    programs = tmp_path / ".venv" / "bin"
    programs.mkdir(parents=True)
    python = f'#!/bin/sh\nexec "{sys.executable}" "$@"\n'
    command = "from launch_scripts.cli import main; raise SystemExit(main())"
    heliarch = f'#!/bin/sh\nexec "{sys.executable}" -c \'{command}\' "$@"\n'
    for name, text in (("python", python), ("heliarch", heliarch)):
        (programs / name).write_text(text, encoding="utf-8")
        (programs / name).chmod(0o755)
    for name in ("examples", "recordings/golden"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).symlink_to(REPOSITORY / name)
    return tmp_path


@pytest.mark.parametrize(
    "document",
    [
        pytest.param(path, id=name, marks=marks(path))
        for path, name in zip(DOCUMENTS, NAMES, strict=True)
        if runnable(path)
    ],
)
def test_the_commands_of_a_document_run_in_order(document: Path, reader: Path) -> None:
    paths = f"{reader / '.venv' / 'bin'}:{os.environ['PATH']}"
    environment = os.environ | {"PATH": paths, "PYTHONPATH": str(REPOSITORY), "COLUMNS": "100"}
    for block in runnable(document):
        done = subprocess.run(
            ["bash", "-e", "-u", "-o", "pipefail", "-c", block.commands],
            cwd=reader,
            env=environment,
            text=True,
            capture_output=True,
            timeout=120,
            check=False,
        )
        accepted = {0, 1} if block.mark == "may fail" else {0}
        assert done.returncode in accepted, f"{block.commands}\n{done.stdout}\n{done.stderr}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=NAMES)
def test_every_command_has_options_that_exist(document: Path) -> None:
    for line, in_prose in heliarch_lines(document):
        error = parse_error(line)
        # In prose a command may stand without its argument, and an option without its value.
        lacks_it = isinstance(error, typer.BadParameter) or "requires an argument" in f"{error}"
        may_lack_it = in_prose and lacks_it
        assert error is None or may_lack_it, f"{line}: {error}"


def parse_error(line: str) -> Exception | None:
    try:
        parse(words_of(line))
    except typer.Exit as left:  # --help and --version
        return left if left.exit_code else None
    except InputError:  # a folder that the document makes
        return None
    except USAGE_ERROR as error:
        return error
    return None


@pytest.mark.parametrize("document", DOCUMENTS, ids=NAMES)
def test_every_make_target_exists(document: Path) -> None:
    targets = set(re.findall(r"^([a-z-]+):", (REPOSITORY / "Makefile").read_text(), re.MULTILINE))
    text = document.read_text(encoding="utf-8")
    named = set(re.findall(r"(?:`|^(?:    )?)make ([a-z-]+)", text, re.MULTILINE))
    assert named <= targets


@pytest.mark.parametrize("document", DOCUMENTS, ids=NAMES)
def test_a_file_that_is_shown_is_the_file_that_comes_with_heliarch(document: Path) -> None:
    for block in blocks_of(document):
        if block.title:
            assert block.text == (REPOSITORY / block.title).read_text(encoding="utf-8")


def parse(words: list[str]) -> None:
    """Parse the arguments of `heliarch` without running anything."""
    assert "--install-completion" not in words, "parsing it would do it"
    group = typer.main.get_command(app)
    assert isinstance(group, typer.core.TyperGroup)
    context = group.make_context("heliarch", list(words))
    name, command, rest = group.resolve_command(context, words)
    assert name is not None
    assert command is not None
    command.make_context(name, rest, parent=context)
