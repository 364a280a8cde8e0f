"""A study over a Dask cluster has the results that it has on one machine."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from command_line import done, refusal

distributed = pytest.importorskip("distributed", reason="Dask is not installed")
pytestmark = pytest.mark.processes

STUDY = "compare oahu --days 2010-04-01..2010-04-03 --duration 2m --schemes uniform-cap,predictive"


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a scheduler on this machine, which has two workers."""
    folder = tmp_path_factory.mktemp("cluster")
    at = folder / "scheduler.json"
    own = ["--scheduler-file", str(at), "--host", "127.0.0.1", "--no-dashboard"]
    commands = [["dask_scheduler", *own, "--port", "0"]]
    commands += [["dask_worker", *own, "--nthreads", "1"]] * 2
    with ExitStack() as stack:
        for module, *words in commands:
            command = [sys.executable, "-m", f"distributed.cli.{module}", *words]
            program = stack.enter_context(
                subprocess.Popen(command, cwd=folder, stderr=subprocess.DEVNULL)
            )
            stack.callback(program.terminate)
        with distributed.Client(scheduler_file=at, timeout=60) as client:
            client.wait_for_workers(2, timeout=60)
            address: str = client.scheduler.address
        yield address


def test_a_comparison_has_the_same_results(cluster: str, tmp_path: Path) -> None:
    here, there = tmp_path / "here.json", tmp_path / "there.json"
    done(*STUDY.split(), "--json", here)
    done(*STUDY.split(), "--json", there, "--cluster", cluster)
    assert there.read_bytes() == here.read_bytes()


def test_the_scheduler_of_a_cluster_must_answer() -> None:
    assert "--cluster" in refusal(*STUDY.split(), "--cluster", "tcp://127.0.0.1:1")
    assert "--cluster" in refusal(*STUDY.split(), "--cluster", "nowhere")
