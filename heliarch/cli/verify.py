"""`heliarch verify`: runs agents again on recorded inputs and compares what they publish."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from heliarch.cli.boundary import FAILED, OK
from heliarch.cli.options import End, Json, Nodes, Run, Start, Tolerance
from heliarch.cli.output import Output, progress_bar

if TYPE_CHECKING:
    from recordings.verify.verification import Verification


def verify(
    run: Run,
    /,
    *more: Annotated[Path, Parameter(help="More runs.")],
    nodes: Nodes = None,
    start: Start = None,
    end: End = None,
    tolerance: Tolerance = 0.0,
    json: Json = None,
) -> int:
    """Run the agents of a recording again and compare outputs.

    They act on the inputs that they used.

    Exit status 1: outputs differ, or not all of them could be compared. The first difference of
    each agent is shown with its inputs, and the verdict says what share was compared. The same code
    runs again: this proves repetition, not that decisions are right.
    Agents run from cycle 0 on; --from and --to say which cycles are compared.

    Example: `heliarch verify runs/oahu-20261121-120000-4711 --nodes 'c2/*'`
    """
    from recordings.verify.comparison import Equality
    from recordings.verify.report import verification_data, verification_lines
    from recordings.verify.verification import verify as verify_run

    results: list[Verification] = []
    rows: list[dict[str, Any]] = []
    equality, output = Equality(tolerance), Output(json)
    for path in (run, *more):
        began_at = time.monotonic()
        with progress_bar("verify") as follow:
            found = verify_run(path, nodes or "", equality, start=start, end=end, progress=follow)
        wall_s = time.monotonic() - began_at
        output.say(str(found.recording), *verification_lines(found, equality, wall_s))
        results.append(found)
        rows.append(verification_data(found, wall_s))
    equal = all(found.equal for found in results)
    output.write({"equal": equal, "runs": rows})
    return OK if equal else FAILED
