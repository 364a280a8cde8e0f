"""`heliarch` with patience of one's own choice: silence on a slow machine is no sign of a fault.

`python patient_heliarch.py STALL_S HEARTBEAT_S WORDS`. In lockstep an agent says for what it waits
after STALL_S, and the run ends. Without a word of the recorder for HEARTBEAT_S, in real time too,
or a new cycle of the plant, it ends as well.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import msgspec

from launch_scripts import launcher, run_command, run_pulse
from launch_scripts.cli import main
from launch_scripts.preparation import Preparation, RunOptions, prepare
from launch_scripts.scenario import ScenarioFile

LONGEST_ARMING_S = 150.0
LONGEST_END_S = 60.0
"""How long processes may take to begin, and to end."""


def be_patient(stall_s: float, heartbeat_s: float) -> None:
    """Let the launcher, and the agents that it starts, wait for so long."""

    def prepare_patiently(scenario: ScenarioFile, options: RunOptions, run_id: str) -> Preparation:
        made = prepare(scenario, options, run_id)
        return replace(made, plan=msgspec.structs.replace(made.plan, stall_timeout_s=stall_s))

    vars(run_command).update(prepare=prepare_patiently)
    vars(run_pulse).update(HEARTBEAT_S=heartbeat_s, PATIENCE_S=heartbeat_s, PLANT_S=heartbeat_s)
    vars(launcher).update(HEARTBEAT_S=heartbeat_s, _ARMING_S=LONGEST_ARMING_S)
    vars(launcher).update(_PATIENCE_S=LONGEST_END_S)


if __name__ == "__main__":
    be_patient(float(sys.argv.pop(1)), float(sys.argv.pop(1)))
    main()
