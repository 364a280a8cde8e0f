"""Records a simulated run anew, in its own place: what the code does now is what it shall do.

Plan and profile stay as they are. So neither the weather nor the clusters are worked out again, and
what differs afterwards is what the agents do.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from agents.plan import RunPlan
from bus_schemas.codec import decode, encode
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import Port
from launch_scripts.launcher.simulation import MemoryRun
from launch_scripts.launcher.supervision import RunFailure
from recordings.read.reader import RunReader
from recordings.record.writer import RunWriter
from recordings.verify.verification import PROFILE_NAME, run_profile
from sim_plant.profile import Profile

_UNFINISHED: Final = ".unfinished"


def check_rerecordable(run: Path) -> None:
    """Refuse a run that cannot be recorded anew without a clock and processes.

    Raises
    ------
    InputError
        It was not made by `simulate` in lockstep, or its profile is not there.
    """
    _origin(run)


def record_anew(run: Path) -> Path:
    """Run the agents and the plant of a recording again and replace the recording.

    Parameters
    ----------
    run
        Folder of the run, or its MCAP file.

    Returns
    -------
    Path
        The recording. It is replaced only once the new one is complete.

    Raises
    ------
    InputError
        See `check_rerecordable`.
    RunFailure
        The agents wait for each other, or one of them fails. The recording stays as it was.
    """
    path, plan, scenario, profile = _origin(run)
    unfinished = path.with_name(path.name + _UNFINISHED)
    unfinished.unlink(missing_ok=True)
    writer = RunWriter(unfinished, plan, scenario, driver="simulate")

    def record(port: Port[Message], message: Message) -> None:
        payload = encode(message)
        decode(port.signal, payload)  # What nobody can read is no recording.
        if port.signal.logged:
            writer.add(port, message, payload, time.monotonic_ns())

    try:
        _run_all(plan, profile, record)
        writer.close()
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    return path


def _run_all(
    plan: RunPlan, profile: Profile, tap: Callable[[Port[Message], Message], None]
) -> None:
    try:
        memory_run = MemoryRun(plan, profile, tap)
        for _ in memory_run.cycles():
            pass
        memory_run.close()
    except (RunFailure, OSError):
        raise
    except (Exception, SystemExit) as error:  # Whatever the code under test does wrong.
        raise RunFailure(
            f"an agent fails: {type(error).__name__}: {error}; the recording stays as it was"
        ) from error


def _origin(run: Path) -> tuple[Path, RunPlan, str, Profile]:
    with RunReader(run) as reader:
        path, plan, scenario = reader.path, reader.plan, reader.scenario
        driver = reader.metadata["run"].get("driver", "")
    if not plan.lockstep or driver != "simulate":
        raise InputError(
            f"--accept: {path} was recorded by {driver}"
            f"{'' if plan.lockstep else ' in real time'}, expected a run of `heliarch simulate` "
            "in lockstep"
        )
    profile = run_profile(plan, path)
    if profile is None:
        raise InputError(f"--accept: no {PROFILE_NAME} lies beside {path}, the plant needs it")
    return path, plan, scenario, profile
