"""Runs seeds of a campaign until one breaks an invariant, of the code that `PYTHONPATH` names.

python first_broken_seed.py oahu 150s 1..300 limit
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import agents
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import load_scenario
from studies.campaign.invariants import Violation
from studies.campaign.study import campaign, faults_of, judged_run, with_standbys
from studies.compare.cases import parse_seeds


def main(scenario: str, duration: str, seeds: str, actuator: str) -> None:
    options = RunOptions(duration=duration, actuator="limit" if actuator == "limit" else "fraction")
    found = campaign(prepare(load_scenario(scenario), options, "campaign"))
    first, broken = 0, list[Violation]()
    for seed in parse_seeds(seeds):
        faults, standby = faults_of(found.plan, seed)
        _, broken = judged_run(found, with_standbys(found.plan, standby), faults)
        if broken:
            first = seed
            break
    code = Path(agents.__file__).parents[1]
    print(
        json.dumps({"code": str(code), "seed": first, "invariants": [b.invariant for b in broken]})
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
