"""An export for viewers, opened by the TypeScript reader of the MCAP project."""

from __future__ import annotations

import filecmp
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from command_line import done
from recordings_by_hand import whole_run, write_run

from recordings.read.reader import RunReader

READER = Path(__file__).with_name("mcap_reader")


@pytest.fixture
def reader(pytestconfig: pytest.Config, tmp_path: Path) -> Path:
    """The reader's script beside its packages, which stay in pytest's cache."""
    if shutil.which("npm") is None or shutil.which("node") is None:
        pytest.skip("node and npm are not installed")
    cache: pytest.Cache | None = getattr(pytestconfig, "cache", None)
    folder = tmp_path / "reader" if cache is None else cache.mkdir("mcap_reader")
    done_last, manifest = folder / "node_modules/.package-lock.json", "package.json"
    if not done_last.exists() or not filecmp.cmp(READER / manifest, folder / manifest):
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(READER, folder)
        options = ("--no-audit", "--no-fund", "--ignore-scripts", "--fetch-retries=0")
        command = ["npm", "install", *options]
        try:
            subprocess.run(command, cwd=folder, capture_output=True, timeout=100, check=True)
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
            pytest.skip(f"the reader cannot be had: {error}")
    return Path(shutil.copy(READER / "read.js", folder))


def test_every_message_is_read_and_is_as_its_schema_says(tmp_path: Path, reader: Path) -> None:
    run, exported = tmp_path / "run.mcap", tmp_path / "export.mcap"
    write_run(run, whole_run(50))
    done("export", run, "--format", "json-mcap", "--out", exported)
    result = subprocess.run(
        ["node", reader, exported], capture_output=True, text=True, timeout=100, check=True
    )
    found: dict[str, Any] = json.loads(result.stdout)
    expected: dict[str, int] = {}
    with RunReader(run) as recording:
        for record in recording.records():
            key = recording.plan.wiring.key(record.port)
            expected[key] = expected.get(key, 0) + 1
    counts = {topic: entry["messages"] for topic, entry in found.items() if entry["messages"]}
    assert counts == expected
    assert {topic: entry["errors"] for topic, entry in found.items() if entry["errors"]} == {}
    assert found["field/production"]["last"]["delivered_kw"] == 239.0
    assert found["field/c1/b/setpoint"]["last"]["help_given"] == [
        {"needy": "c1/a", "power_kw": 20.0}
    ]
