"""`heliarch doctor` finds what would stop a run, and says what to do about it."""

from __future__ import annotations

import json
import subprocess
import sys

from running import REPOSITORY


def test_too_few_open_files_are_wrong_and_each_trouble_has_advice() -> None:
    doctor = f"ulimit -n 120; exec '{sys.executable}' -m launch_scripts doctor --json -"
    ended = subprocess.run(
        ["bash", "-c", doctor], capture_output=True, text=True, cwd=REPOSITORY, check=False
    )
    found = {finding["about"]: finding for finding in json.loads(ended.stdout)}
    assert ended.returncode == 1
    assert found["open files"]["verdict"] == "wrong"
    assert "ulimit" in found["open files"]["advice"]
    assert all(finding["advice"] for finding in found.values() if finding["verdict"] != "ok")
