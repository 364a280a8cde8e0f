"""Every command in the documents runs; one that is too long for a test has options that exist."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
from command_line import heliarch
from cyclopts.exceptions import CoercionError, CycloptsError, MissingArgumentError, ValidationError
from documents import DOCUMENTS, REPOSITORY, Block, blocks_of, heliarch_lines, words_of

from heliarch.cli.app import app, checked

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
    command = "from heliarch.cli.main import main; raise SystemExit(main())"
    script = f'#!/bin/sh\nexec "{sys.executable}" -c \'{command}\' "$@"\n'
    for name, text in (("python", python), ("heliarch", script)):
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
def test_the_commands_of_a_document_run_in_order(
    document: Path, reader: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their output is that of the document, whatever its spaces; `[...]` stands for what is cut."""
    monkeypatch.chdir(reader)
    monkeypatch.setenv("COLUMNS", "100")  # as wide as the documents
    printed, was_run = "", False
    for block in blocks_of(document):
        if block.commands.strip():
            was_run = block.mark != "not run"
            if was_run:
                status, printed = run(block)
                accepted = {0, 1} if block.mark == "may fail" else {0}
                assert status in accepted, f"{block.commands}\n{printed}"
        if was_run:
            seen = {" ".join(line.split()) for line in printed.splitlines()}
            missing = [line for line in block.output if " ".join(line.split()) not in seen]
            assert missing == []
        was_run = was_run and bool(block.commands)


def run(block: Block) -> tuple[int, str]:
    """Run a block: in this process, unless it takes a shell. Return exit status and output."""
    lines = block.commands.replace("\\\n", " ").splitlines()
    if block.language == "python":
        with redirect_stdout(StringIO()) as printed:
            exec(compile(block.commands, "document", "exec"), {"__name__": "__main__"})
        return 0, printed.getvalue()
    if not all(re.fullmatch(r"heliarch [^&|<>;]*(#.*)?", line) for line in lines):
        return run_in_shell(block.commands)
    output = ""
    for line in lines:
        result = heliarch(*words_of(line))
        output += result.output
        if result.exit_code:
            return result.exit_code, output
    return 0, output


def run_in_shell(commands: str) -> tuple[int, str]:
    """Run commands in the working folder, where `heliarch` and `python` are."""
    paths = f"{Path.cwd() / '.venv' / 'bin'}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-e", "-u", "-o", "pipefail", "-c", commands],
        env=os.environ | {"PATH": paths, "PYTHONPATH": str(REPOSITORY)},
        text=True,
        capture_output=True,
        timeout=120,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("document", DOCUMENTS, ids=NAMES)
def test_every_command_has_options_that_exist(document: Path) -> None:
    wrong = [
        f"{line}: {complaint}"
        for line, in_prose in heliarch_lines(document)
        if (complaint := complaint_about(line, in_prose))
    ]
    assert wrong == []


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


def complaint_about(line: str, in_prose: bool) -> str:
    """Parse a `heliarch` command without running it; return what is wrong with it."""
    words = words_of(line)
    try:
        app.parse_args(checked(words))
    except ValidationError:  # a folder that the document makes
        return ""
    except (CoercionError, MissingArgumentError) as error:
        return "" if in_prose else str(error)  # `--format FORMAT`; an argument may be left out
    except CycloptsError as error:
        return str(error)
    return ""
