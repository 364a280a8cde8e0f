"""`heliarch verify`: runs agents again on recorded inputs and compares what they publish."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from math import inf
from pathlib import Path
from typing import Any, Final

import msgspec
from rich.console import Console

from bus_schemas.errors import InputError
from launch_scripts.commands.reading_progress import reading_progress
from launch_scripts.exit_status import BAD_INPUT, INTERRUPTED, complain
from launch_scripts.launcher.json_rows import check_json_destination
from launch_scripts.launcher.supervision import RunFailure
from recordings.verify.comparison import COMPARED_FIELDS, Comparison
from recordings.verify.report import json_ready, verification_data, verification_lines
from recordings.verify.verification import Verification, verify

EQUAL: Final = 0
DIFFERENT: Final = 1


@dataclass(frozen=True, slots=True)
class VerifyRequest:
    """The arguments of the command line."""

    runs: Sequence[Path]
    nodes: Sequence[str]
    tolerance: float
    ignored: Sequence[str]
    accept: bool
    json: str | None


def run_verify(request: VerifyRequest) -> int:
    """Verify runs and print the result. Returns the exit status.

    0: every agent publishes what it published, or the change is accepted. 1: there is a difference.
    """
    out = Console(stderr=request.json == "-", soft_wrap=True, highlight=False, markup=False)
    try:
        nodes, comparison = _checked(request)
        results = [_verify(run, nodes, comparison, out) for run in request.runs]
        found = [verification for verification, _ in results]
        equal = all(verification.equal for verification in found)
        _write_json({"equal": equal, "runs": [data for _, data in results]}, request.json)
        if request.accept:
            for verification in found:
                _accept(verification, out)
    except InputError as error:
        return complain(error, BAD_INPUT)
    except RunFailure as error:
        return complain(error, DIFFERENT)
    except OSError as error:
        return complain(f"{error.filename or ''}: {error.strerror}", BAD_INPUT)
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)
    return EQUAL if equal or request.accept else DIFFERENT


def _checked(request: VerifyRequest) -> tuple[list[str], Comparison]:
    nodes, ignored = _names(request.nodes), _names(request.ignored)
    if not 0.0 <= request.tolerance < inf:
        raise InputError(f"--tolerance: expected a number from 0 on, got {request.tolerance:g}")
    for name in ignored:
        if name not in COMPARED_FIELDS:
            near = get_close_matches(name, COMPARED_FIELDS) or COMPARED_FIELDS
            raise InputError(f"--ignore: expected a field such as {', '.join(near)}, got {name}")
    if request.accept and nodes:
        raise InputError("--accept: expected no --nodes with it: the whole run is recorded again")
    check_json_destination(request.json)
    if request.accept:
        # Imported only here: it brings weather and market with it.
        from recordings.verify.golden import origin  # noqa: PLC0415

        for run in request.runs:
            origin(run)
    return nodes, Comparison(request.tolerance, frozenset(ignored))


def _names(texts: Sequence[str]) -> list[str]:
    """Return the names in options that may be repeated, or hold several with commas between."""
    return [name.strip() for text in texts for name in text.split(",") if name.strip()]


def _verify(
    run: Path, nodes: Sequence[str], comparison: Comparison, out: Console
) -> tuple[Verification, dict[str, Any]]:
    began_at = time.monotonic()
    with reading_progress("verify") as progress:
        found = verify(run, nodes, comparison, progress)
    wall_s = time.monotonic() - began_at
    for line in verification_lines(found, comparison, wall_s):
        out.print(line)
    return found, verification_data(found, comparison, wall_s)


def _accept(found: Verification, out: Console) -> None:
    if found.equal:
        out.print(f"{found.recording}: nothing to accept")
        return
    for name, findings in found.agents.items():
        if findings.failure is not None:
            raise RunFailure(
                f"--accept {found.recording}: {name} fails in cycle {findings.failure.cycle}: "
                f"{findings.failure.text}"
            )
    from recordings.verify.golden import record_again  # noqa: PLC0415

    record_again(found.recording)
    out.print(f"{found.recording}: recorded again as the agents behave now")


def _write_json(document: dict[str, Any], json: str | None) -> None:
    if json is None:
        return
    text = msgspec.json.format(msgspec.json.encode(json_ready(document)), indent=1) + b"\n"
    try:
        if json == "-":
            sys.stdout.write(text.decode())
            sys.stdout.flush()
        else:
            Path(json).write_bytes(text)
    except OSError as error:
        raise RunFailure(f"--json {json}: {error.strerror}") from error
