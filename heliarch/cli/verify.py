"""`heliarch verify`: runs agents again on recorded inputs and compares what they publish."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from heliarch.cli.boundary import FAILED, OK
from heliarch.cli.junit import Case, check_junit, write_junit
from heliarch.cli.options import Json, Junit, Nodes, Run, Tolerance
from heliarch.cli.output import Output, progress_bar

if TYPE_CHECKING:
    from recordings.verify.verification import Verification


def verify(
    run: Run,
    /,
    *more: Annotated[Path, Parameter(help="More runs.")],
    nodes: Nodes = None,
    tolerance: Tolerance = 0.0,
    json: Json = None,
    junit: Junit = None,
) -> int:
    """Run the agents of a recording again and compare outputs.

    They act on the inputs that they used.

    Exit status 1: outputs differ, or not all of them could be compared. The first difference of
    each agent is shown with its inputs, and the verdict says what share was compared. The same code
    runs again: this proves repetition, not that decisions are right.

    Example: `heliarch verify runs/oahu-20261121-120000-4711 --nodes 'c2/*'`
    """
    from recordings.verify.comparison import Equality
    from recordings.verify.report import verification_data, verification_lines
    from recordings.verify.verification import verify as verify_run

    check_junit(junit)
    results: list[Verification] = []
    rows: list[dict[str, Any]] = []
    equality, output = Equality(tolerance), Output(json)
    for path in (run, *more):
        began_at = time.monotonic()
        with progress_bar("verify") as follow:
            found = verify_run(path, nodes or "", equality, progress=follow)
        wall_s = time.monotonic() - began_at
        output.say(str(found.recording), *verification_lines(found, equality, wall_s))
        results.append(found)
        rows.append(verification_data(found, wall_s))
    equal = all(found.equal for found in results)
    output.write({"equal": equal, "runs": rows})
    write_junit(junit, {f"verify {found.recording}": _cases(found) for found in results})
    return OK if equal else FAILED


def _cases(found: Verification) -> Iterator[Case]:
    """Yield a case for each agent; one of which not all was compared fails."""
    for agent, result in found.agents.items():
        text = ""
        if (first := result.first) is not None:
            text = f"cycle {first.cycle}, {first.message or first.text}: {first.kind}"
        elif result.compared < result.recorded:
            text = f"{result.compared:,} of {result.recorded:,} messages compared"
        yield Case(agent, text)
    yield from (Case(agent, skipped=why) for agent, why in found.left_out.items())
