"""`heliarch verify`: runs agents again on recorded inputs and compares what they publish."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bus_schemas.errors import FailureError, InputError
from launch_scripts.commands.boundary import FAILED, OK
from launch_scripts.commands.output import progress_bar, say, write_json
from studies.tables import console_for

if TYPE_CHECKING:
    from rich.console import Console

    from recordings.verify.comparison import Comparison
    from recordings.verify.verification import Verification


def verify(
    runs: list[Path],
    nodes: str | None = None,
    start: str | None = None,
    end: str | None = None,
    tolerance: float = 0.0,
    ignored: str | None = None,
    accept: bool = False,
    json: str | None = None,
) -> int:
    """Run the agents of a recording again on the inputs that they used, and compare the outputs.

    Exit status 1: outputs differ. The first difference of each agent is shown
    with its inputs. Agents run from cycle 0 on; --from and --to say which
    cycles are compared.

    RUN... (runs): Folders of runs, or their run.mcap.
    --tolerance X 0..: Largest difference between numbers that count as equal.
    --ignore FIELDS (ignored): Fields that may differ, with commas.
    --accept: Replace the recording by what the agents do now.
    Example: heliarch verify runs/oahu-20261121-120000-4711 --nodes 'c2/*'
    """
    from recordings.verify.comparison import FIELDS, Comparison

    console = console_for(json)
    names = frozenset(ignored.split(",")) if ignored else frozenset()
    for name in names - FIELDS:
        raise InputError(f"--ignore: expected fields of messages, got {name}")
    comparison = Comparison(tolerance, names)
    if accept:
        from recordings.verify.golden import origin

        if nodes or start or end:
            raise InputError("--accept: expected neither --nodes, --from nor --to with it")
        for run in runs:
            origin(run)  # Refuses what cannot be recorded again, before any work.
    results = [_verify(run, nodes or "", comparison, start, end, console) for run in runs]
    equal = all(found.equal for found, _ in results)
    write_json({"equal": equal, "runs": [data for _, data in results]}, json)
    if accept:
        for found, _ in results:
            _accept(found, console)
    return OK if equal or accept else FAILED


def _verify(
    run: Path,
    nodes: str,
    comparison: Comparison,
    start: str | None,
    end: str | None,
    console: Console,
) -> tuple[Verification, dict[str, Any]]:
    from recordings.verify.report import verification_data, verification_lines
    from recordings.verify.verification import verify as verify_run

    began_at = time.monotonic()
    with progress_bar("verify") as follow:
        found = verify_run(run, nodes, comparison, follow, start, end)
    wall_s = time.monotonic() - began_at
    say(console, str(found.recording))
    say(console, *verification_lines(found, comparison, wall_s))
    return found, verification_data(found, wall_s)


def _accept(found: Verification, console: Console) -> None:
    from recordings.verify.golden import record_again

    if found.equal:
        say(console, f"{found.recording}: nothing to accept")
        return
    for name, findings in found.agents.items():
        if findings.failure is not None:
            raise FailureError(
                f"--accept {found.recording}: {name} fails in cycle {findings.failure.cycle}: "
                f"{findings.failure.text}"
            )
    record_again(found.recording)
    say(console, f"{found.recording}: recorded again as the agents behave now")
