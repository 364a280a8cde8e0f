"""Makes the golden recordings anew: `make golden`. The table of README.md says what each is for."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

GOLDEN: Final = Path(__file__).parent

RUNS: Final = {
    "oahu-predictive": "oahu --duration 24s",
    "oahu-limit": "oahu --actuator limit --duration 20s",
    "oahu-day-paper": "oahu-day --scheme paper --start 12:13:08 --duration 16s",
    "valley-periods": f"{GOLDEN / 'valley-periods.toml'} --start 13:02:00 --duration 8s",
}
"""Words of `heliarch simulate` for each recording."""

KEPT: Final = ("run.mcap", "profile.npz")
"""The recording carries plan and scenario; without the profile the plant cannot be re-run."""


def main() -> None:
    """Simulate each run and keep its recording and profile."""
    for name, words in RUNS.items():
        with tempfile.TemporaryDirectory() as scratch:
            run = Path(scratch) / "run"
            command = ["-m", "launch_scripts", "simulate", *words.split(), "--out", str(run)]
            subprocess.run([sys.executable, *command], check=True, stdout=subprocess.DEVNULL)
            (GOLDEN / name).mkdir(exist_ok=True)
            for file in KEPT:
                shutil.move(run / file, GOLDEN / name / file)
        print(f"{GOLDEN / name}: made anew")  # noqa: T201


if __name__ == "__main__":
    main()
