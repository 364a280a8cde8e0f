"""A whole plant whose inverters are all reached over Modbus, beside the same one without."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import command_line
import psutil
import pytest
from quirky import quirky
from running import REPOSITORY, Start, small_plant

from recordings.inspect.overview import read_overview
from recordings.read.reader import RunReader
from sunspec.addresses import parse_address
from sunspec.process import read_accounts

pytestmark = pytest.mark.processes


@pytest.fixture
def scenario(tmp_path: Path) -> str:
    return small_plant(
        tmp_path / "scenario",
        ("cycle_s = 1", "cycle_s = 0.25"),
        ("[irradiance]", 'actuator = "limit"\navailable_bias = 0.0\n\n[irradiance]'),
    )


@contextmanager
def inverters(scenario: str, port: str = "0") -> Iterator[list[str]]:
    """Serve a scenario's inverters; gives the options of `launch` that say where they are."""
    words = [sys.executable, "-m", "heliarch", "inverters", scenario, "--port", port]
    with subprocess.Popen(
        [*words, "--wait"], stdout=subprocess.PIPE, text=True, cwd=REPOSITORY
    ) as process:
        assert process.stdout is not None
        options: list[str] = []
        try:
            while (line := process.stdout.readline()).startswith("--device "):
                options += line.split()
            yield options  # The last one is the meter's.
        finally:
            process.kill()


@pytest.fixture
def served_inverters(scenario: str) -> Iterator[list[str]]:
    with inverters(scenario) as options:
        yield options


def test_energies_are_those_of_simulated_inverters(
    scenario: str, served_inverters: list[str], heliarch: Start
) -> None:
    span = ("launch", scenario, "--pace", "1", "--duration", "8s")
    plain, real = heliarch(*span), heliarch(*span, *served_inverters)
    assert (plain.wait(), real.wait()) == (0, 0), real.error_text()
    expected, found = (_summary(run.folder) for run in (plain, real))
    for energy in ("dispatched-energy", "available-energy", "delivered-energy"):
        assert found["figures"][energy] == pytest.approx(expected["figures"][energy], rel=0.1)
    assert [device["node"] for device in found["devices"]] == [
        "c1/inv01", "c1/inv02", "c2/inv03", "c2/inv04", "meter"
    ]  # fmt: skip
    assert all(
        device["reads"]["count"] and (device["writes"]["count"] or device["node"] == "meter")
        for device in found["devices"]
    )
    assert not list(real.folder.glob("device-*"))

    verified = command_line.heliarch("verify", real.folder)
    assert verified.exit_code == 1  # Not all could be compared.
    assert "plant" in verified.output
    assert "devices" in verified.output


def test_the_health_names_a_device_that_was_gone_for_a_while(
    scenario: str, heliarch: Start
) -> None:
    with inverters(scenario) as options:
        address = options[1].partition("=")[2]
        words = ("launch", scenario, "--pace", "1", "--duration", "5m", *options[:2])
        run = heliarch(*words)
        run.until_running()
    run.until(lambda: _gone_s(run.folder) > 2.0, "the loss of the device")
    with inverters(scenario, str(parse_address(address, "")[1])):
        run.until_shown("connected again")
        cycles = run.recorded_cycles()
        run.until_recorded(cycles + 8)
        assert run.interrupt() == 130
    with RunReader(run.folder) as reader:
        health = read_overview(reader)
    (absence,) = [found for found in health.states if found.agent == "device c1/inv01"]
    assert absence.back_in is not None
    assert read_accounts(run.folder)[0].breaks
    assert "device c1/inv01: absent in cycles" in " ".join(run.output.read_text().split())


def test_silent_slow_and_dropping_inverters_disturb_nobody_else(
    scenario: str, heliarch: Start
) -> None:
    def dropping(number: int, answer: bytes) -> list[bytes]:
        return [answer] if number % 10 else []

    slower = ("--set", "time.cycle_s=1")  # 300 ms for a request: a round takes longer.
    with (
        quirky() as dies,
        quirky() as sleeps,
        quirky(slow_s=0.3) as slow,
        quirky(answers=dropping) as drops,
    ):
        places = {"c1/inv01": dies, "c1/inv02": sleeps, "c2/inv03": slow, "c2/inv04": drops}
        options = [f"--device={node}={one.address}" for node, one in places.items()]
        run = heliarch("launch", scenario, "--pace", "1", "--duration", "24", *slower, *options)
        run.until_recorded(4)
        dies.__exit__()
        sleeps.power_w = None  # It states no power, and not that it sleeps.
        assert run.wait() == 0, run.error_text()
    summary = _summary(run.folder)
    assert summary["messages_lost"] == 0
    assert not summary["restarts"]
    accounts = {account.node: account for account in read_accounts(run.folder)}
    assert accounts["c1/inv01"].gone_s is not None
    assert accounts["c1/inv02"].refused
    assert accounts["c2/inv03"].late
    assert accounts["c2/inv04"].breaks
    with RunReader(run.folder) as reader:
        states = read_overview(reader).states
    assert {found.agent for found in states} <= {f"device {node}" for node in places}
    said = run.output.read_text()
    assert said.count("connection closed by the device") == 1
    assert "a cycle of 1 s is too short" in said


def _gone_s(folder: Path) -> float:
    return sum(account.gone_s or 0.0 for account in read_accounts(folder))


def test_a_run_names_its_gateway_that_was_killed(
    scenario: str, served_inverters: list[str], heliarch: Start
) -> None:
    run = heliarch("launch", scenario, "--pace", "1", "--duration", "5m", *served_inverters)
    run.until_running()
    children = psutil.Process(run.process.pid).children()
    (gateway,) = [child for child in children if child.cmdline()[-1] == "sunspec.gateway"]
    gateway.kill()
    assert run.wait() == 1
    log = run.folder / "logs" / "gateway.log"
    failure = (run.folder / "failure.txt").read_text()
    for fact in (str(gateway.pid), "status -9", str(log)):
        assert fact in failure
    assert "c1/inv01" in log.read_text()


def test_a_device_that_cannot_be_reached_is_refused_in_one_line(
    scenario: str, tmp_path: Path
) -> None:
    nobody = "c1/inv01=modbus://127.0.0.1:1/1"
    words = ("--pace", "1", "--device", nobody, "--out", tmp_path / "run")
    refused = command_line.heliarch("launch", scenario, *words)
    assert refused.exit_code == 2
    (line,) = refused.stderr.splitlines()
    assert "refused" in line
    assert not (tmp_path / "run").exists()


def _summary(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return found
