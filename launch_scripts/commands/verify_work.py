"""`heliarch verify`: agents re-run on recorded inputs, and what they say held against the old."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from math import inf
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from bus_schemas.errors import InputError
from launch_scripts.exit_status import BAD_INPUT, INTERRUPTED, complain
from launch_scripts.launcher.json_rows import check_json_destination
from launch_scripts.launcher.supervision import RunFailure
from recordings.verify.comparison import COMPARED_FIELDS, Comparison
from recordings.verify.outcome import Outcome, as_json
from recordings.verify.verification import Verification, verify

EQUAL: Final = 0
DIFFERENT: Final = 1

_PROGRESS_CYCLES: Final = 100
"""The bar moves once in so many cycles."""


@dataclass(frozen=True, slots=True)
class VerifyRequest:
    """The words of the command line, None where the user said nothing."""

    runs: Sequence[Path]
    nodes: Sequence[str]
    tolerance: float
    ignored: Sequence[str]
    accept: bool
    json: str | None


def run_verify(request: VerifyRequest) -> int:
    """Verify what was asked for and say what it came to. Returns the exit status.

    0: every agent says what it said; or the new recording is accepted. 1: there is a difference,
    or the recording has lost so much that nobody can tell, or what was found cannot be written.
    """
    out = Console(stderr=request.json == "-", soft_wrap=True, highlight=False, markup=False)
    try:
        nodes, comparison = _plan(request)
        outcomes = [_verify(run, nodes, comparison, out) for run in request.runs]
        _write_json(outcomes, request.json)
        if request.accept:
            for outcome in outcomes:
                _accept(outcome.verification, out)
    except InputError as error:
        return complain(error, BAD_INPUT)
    except RunFailure as error:
        return complain(error, DIFFERENT)
    except OSError as error:
        return complain(f"{error.filename or ''}: {error.strerror}", BAD_INPUT)
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)
    equal = all(outcome.verification.equal for outcome in outcomes)
    return EQUAL if equal or request.accept else DIFFERENT


def _plan(request: VerifyRequest) -> tuple[list[str], Comparison]:
    nodes, ignored = _words(request.nodes), _words(request.ignored)
    if not 0.0 <= request.tolerance < inf:
        raise InputError(f"--tolerance {request.tolerance:g}: accepted is 0 or more")
    for name in ignored:
        if name not in COMPARED_FIELDS:
            near = get_close_matches(name, COMPARED_FIELDS) or COMPARED_FIELDS
            raise InputError(f"--ignore {name}: no message has it, accepted: {', '.join(near)}")
    if request.accept and nodes:
        raise InputError("--accept: the whole run is recorded anew, accepted is no --node with it")
    check_json_destination(request.json)
    if request.accept:
        _check_rerecordable(request.runs)
    return nodes, Comparison(request.tolerance, frozenset(ignored))


def _check_rerecordable(runs: Sequence[Path]) -> None:
    # Weather and market come with it: who only verifies need not wait for them.
    from recordings.verify.golden import check_rerecordable  # noqa: PLC0415

    for run in runs:
        check_rerecordable(run)


def _words(texts: Sequence[str]) -> list[str]:
    """Return the words of options that may be repeated, or name several with commas between."""
    return [word.strip() for text in texts for word in text.split(",") if word.strip()]


def _verify(run: Path, nodes: Sequence[str], comparison: Comparison, out: Console) -> Outcome:
    began_at = time.monotonic()
    with _progress() as bar:
        task = bar.add_task("cycles", total=None)

        def advance(cycle: int, cycles: int) -> None:
            if cycle % _PROGRESS_CYCLES == 0:
                bar.update(task, completed=cycle, total=cycles)

        found = verify(run, nodes, comparison, advance)
    outcome = Outcome(found, comparison, time.monotonic() - began_at)
    for line in outcome.lines():
        out.print(line)
    return outcome


@contextmanager
def _progress() -> Iterator[Progress]:
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        yield bar


def _accept(found: Verification, out: Console) -> None:
    if found.equal:
        out.print(f"{found.recording}: nothing to accept")
        return
    for name, account in found.accounts.items():
        if account.failure is not None:
            raise RunFailure(
                f"--accept: {name} fails in cycle {account.failure.cycle} "
                f"({account.failure.text}); {found.recording} stays as it was"
            )
    from recordings.verify.golden import record_anew  # noqa: PLC0415

    path = record_anew(found.recording)
    out.print(f"{path}: accepted, recorded anew as the agents behave now")


def _write_json(outcomes: Sequence[Outcome], json: str | None) -> None:
    if json is None:
        return
    try:
        if json == "-":
            sys.stdout.write(as_json(outcomes).decode() + "\n")
            sys.stdout.flush()
        else:
            Path(json).write_bytes(as_json(outcomes) + b"\n")
    except OSError as error:
        raise RunFailure(f"--json {json}: {error.strerror}") from error
