"""`heliarch conform` on devices that meet all requirements, and on others that miss one."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import command_line
import pytest
from running import small_plant

from studies.conformance.requirements import REQUIREMENTS

pytestmark = pytest.mark.processes


REPOSITORY = Path(__file__).parents[2]
EXAMPLES = REPOSITORY / "examples"
WRONG = Path(__file__).with_name("wrong_device.py")
NODE = "c1/inv01"
OWN = f"{sys.executable} -m launch_scripts.process {{node}} --plan {{plan}}"
CONTROLLER = f"{sys.executable} {EXAMPLES / 'direct_controller.py'} --plan {{plan}} --node {{node}}"


@pytest.fixture
def plant(tmp_path: Path) -> str:
    return small_plant(tmp_path / "plant", ("[control]\n", "[control]\nhold_cycles = 2\n"))


def failures(plant: str, pace: str = "max") -> list[dict[str, Any]]:
    """All failures that the newest trial of a device wrote."""
    document = json.loads(Path(plant).with_name(f"results-{pace}").read_text(encoding="utf-8"))
    return list(document["failures"])


def results(plant: str, agent: str, command: str, *more: str, pace: str = "max") -> dict[str, str]:
    """Try a device; return the result of each requirement."""
    file, out = (Path(plant).with_name(f"{name}-{pace}") for name in ("results", "trials"))
    words = ("--scenario", plant, "--pace", pace, "--external-timeout", "20", "--out", out)
    ended = command_line.heliarch(
        "conform", agent, *words, "--json", file, "--command", command, *more
    )
    found = json.loads(file.read_text(encoding="utf-8"))
    text = json.dumps(found, indent=1) + ended.output
    assert ended.exit_code == (0 if found["passed"] else 1), text
    passed = all(row["result"] in {"PASS", "not tried"} for row in found["requirements"])
    assert found["passed"] == passed, text
    print(text)
    return {row["requirement"]: row["result"] for row in found["requirements"]}


def in_real_time(plant: str, agent: str, command: str) -> dict[str, str]:
    """Try a device at a pace that this machine keeps up with, where the device can."""
    for pace in ("8", "2", "1"):
        found = results(plant, agent, command, pace=pace)
        if not {"FAIL", "too slow"} & set(found.values()):
            break
    return found


def failed(found: dict[str, str]) -> set[str]:
    return {name for name, result in found.items() if result == "FAIL"}


@pytest.mark.timeout(600)  # On a busy machine it is tried at three paces.
def test_the_example_controller_meets_every_requirement(tmp_path: Path) -> None:
    rarely = "[control]\nhold_cycles = 2\nperiod_cycles = [4, 2]\n"
    plant = small_plant(tmp_path / "plant", ("[control]\n", rarely))
    assert in_real_time(plant, NODE, CONTROLLER) == dict.fromkeys(REQUIREMENTS, "PASS")


def test_the_example_controller_of_a_storage_decides_what_our_own_does(plant: str) -> None:
    battery = "[[storage]]\nname = 'battery'\ncluster = 'c1'\nrating_kw = 100\ncapacity_kwh = 5\n"
    with Path(plant).open("a", encoding="utf-8") as file:
        file.write(battery)
    command = CONTROLLER.replace("direct_controller", "storage_controller")
    found = results(plant, "c1/battery", command)
    assert not failed(found)
    assert found["limits"] == "PASS"


@pytest.mark.parametrize("agent", ["c1", pytest.param("central", marks=pytest.mark.soak)])
def test_our_own_controllers_pass_in_their_own_place(agent: str, plant: str) -> None:
    found = results(plant, agent, OWN)
    assert not failed(found)
    tried = {name for name, result in found.items() if result == "PASS"}
    assert tried >= {"arming", "decisions", "head", "limits", "replaced"}


def wrong_device(faults: str) -> str:
    return f"{sys.executable} {WRONG} '{faults}' {{plan}} {{node}}"


def test_a_device_with_faults_fails_where_it_is_wrong_and_nowhere_else(plant: str) -> None:
    faults = {"decisions", "head", "bounds", "wrong messages", "replaced"}
    found = failed(results(plant, NODE, wrong_device(",".join(sorted(faults)))))
    assert found == faults
    every = failures(plant)
    assert {one["requirement"] for one in every} == faults
    wrong = [one for one in every if one["requirement"] == "wrong messages"]
    assert len(wrong) > 1, "not only the first"
    (first, *_) = [one for one in every if one["requirement"] == "decisions"]
    assert (first["trial"], first["cycle"], first["message"]) == (
        "lockstep",
        3,
        f"{NODE}/residual",
    )
    (telemetry,) = first["inputs"][f"{NODE}/telemetry"]
    assert telemetry["cycle"] == 3


@pytest.mark.soak
@pytest.mark.parametrize("fault", ["arming", "links", "limits", "stop"])
def test_a_device_with_one_fault_fails(fault: str, plant: str) -> None:
    found = results(plant, NODE, wrong_device(fault))
    assert found[fault] == "FAIL"
    assert found["token"] == "PASS"


# In C ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def controller_in_c(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program of examples/c, where zenoh-pico is installed."""
    if shutil.which("cmake") is None:
        pytest.skip("cmake is not installed")
    build = tmp_path_factory.mktemp("c")
    configured = subprocess.run(
        ["cmake", "-S", EXAMPLES / "c", "-B", build],
        capture_output=True,
        text=True,
        check=False,
    )
    if configured.returncode:
        assert "zenohpico" in configured.stderr
        pytest.skip("zenoh-pico is not installed: see docs/own-device.md")
    subprocess.run(["cmake", "--build", build], check=True, capture_output=True)
    return build / "controller"


@pytest.mark.timeout(600)
def test_the_controller_in_c_meets_every_requirement(controller_in_c: Path, plant: str) -> None:
    found = in_real_time(plant, NODE, f"{controller_in_c} {{plan}} {{node}}")
    assert found == dict.fromkeys(REQUIREMENTS, "PASS")
