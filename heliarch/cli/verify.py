"""`heliarch verify`: runs agents again on recorded inputs and compares what they publish."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from rich.console import Console

from bus_schemas.errors import FailureError, InputError
from heliarch.cli.boundary import FAILED, OK
from heliarch.cli.options import End, Json, Nodes, Run, Start, Tolerance
from heliarch.cli.output import progress_bar, say, write_json
from results.tables import console_for

if TYPE_CHECKING:
    from recordings.verify.equality import Equality
    from recordings.verify.verification import Verification


def verify(
    run: Run,
    /,
    *more: Annotated[Path, Parameter(help="More runs.")],
    nodes: Nodes = None,
    start: Start = None,
    end: End = None,
    tolerance: Tolerance = 0.0,
    accept: bool = False,
    json: Json = None,
) -> int:
    """Run the agents of a recording again on the inputs that they used, and compare the outputs.

    Exit status 1: outputs differ, or none could be compared. The first difference of each agent is
    shown with its inputs, and the verdict says what share of the messages was compared.
    Agents run from cycle 0 on; --from and --to say which cycles are compared.

    Example: `heliarch verify runs/oahu-20261121-120000-4711 --nodes 'c2/*'`

    Parameters
    ----------
    accept
        Replace the recording by what the agents do now.
    """
    from recordings.verify.equality import Equality

    runs, console, equality = (run, *more), console_for(json), Equality(tolerance)
    if accept:
        from studies.golden import origin

        if nodes or start or end:
            raise InputError("--accept: expected neither --nodes, --from nor --to with it")
        for path in runs:
            origin(path)  # Refuses what cannot be recorded again, before any work.
    results = [_verify(path, nodes or "", equality, start, end, console) for path in runs]
    equal = all(found.equal for found, _ in results)
    write_json({"equal": equal, "runs": [data for _, data in results]}, json)
    if accept:
        for found, _ in results:
            _accept(found, console)
    return OK if equal or accept else FAILED


def _verify(
    run: Path,
    nodes: str,
    equality: Equality,
    start: str | None,
    end: str | None,
    console: Console,
) -> tuple[Verification, dict[str, Any]]:
    from recordings.verify.report import verification_data, verification_lines
    from recordings.verify.verification import verify as verify_run

    began_at = time.monotonic()
    with progress_bar("verify") as follow:
        found = verify_run(run, nodes, equality, start=start, end=end, progress=follow)
    wall_s = time.monotonic() - began_at
    say(console, str(found.recording))
    say(console, *verification_lines(found, equality, wall_s))
    return found, verification_data(found, wall_s)


def _accept(found: Verification, console: Console) -> None:
    from studies.golden import record_again

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
