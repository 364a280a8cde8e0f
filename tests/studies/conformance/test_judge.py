"""What `conform` says of a device's answers, shown on recorded answers of our own agent."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import done
from msgspec.structs import replace
from running import small_plant

from bus_schemas.messages import Message
from bus_schemas.signals import COMMAND, IMPP, RESIDUAL, Port
from recordings.verify.comparison import BIT_FOR_BIT
from studies.conformance.device import Device
from studies.conformance.judge import Answer, DeviceRun, judge

NODE = "c1/inv01"
CYCLE = 4


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of ten cycles by a clock, which faults elsewhere give it."""
    folder = tmp_path_factory.mktemp("judge")
    elsewhere = ("--fault", "loss=0.1,source=c2/*,listener=c2")
    plant = small_plant(folder / "plant")
    words = ("--duration", "10", "--scheme", "paper", *elsewhere)
    done("simulate", plant, *words, "--out", folder / "run")
    return folder / "run"


@pytest.fixture
def recorded(run: Path) -> DeviceRun:
    return DeviceRun.of(run, NODE)


@pytest.mark.parametrize("port", [IMPP.of(NODE), COMMAND.of(NODE)], ids=str)
def test_a_late_answer_is_called_late_by_how_much_and_nothing_else(
    recorded: DeviceRun, port: Port[Message]
) -> None:
    """One defect: late at any stage, and what it then decides on other inputs."""
    (answer,) = recorded.answers[port, CYCLE]
    late_ns = 950_000_000
    late_at_ns = answer.message.publish_time_ns + late_ns
    message = replace(answer.message, publish_time_ns=late_at_ns, power_kw=1.0)
    recorded.answers[port, CYCLE] = [Answer(message, answer.heard_ns + late_ns)]
    (finding,) = judge(recorded, BIT_FOR_BIT)
    assert finding.cycle == CYCLE
    assert "answered 950 ms late" in finding.text


@pytest.mark.parametrize(
    ("changes", "requirement", "named"),
    [
        ({"power_kw": 1.0}, "", "power_kw: expected"),
        ({"power_kw": 1e6}, "bounds", "power_kw: expected"),
        ({"sim_time_ns": 7}, "head", "sim_time_ns: expected"),
        ({"incarnation": 2}, "head", "incarnation: expected"),
        ({"publish_time_ns": 1 << 60}, "head", "publish_time_ns of this clock"),
    ],
)
def test_a_wrong_field_fails_one_requirement(
    recorded: DeviceRun, changes: dict[str, float], requirement: str, named: str
) -> None:
    port = RESIDUAL.of(NODE)
    ((message, heard_ns),) = recorded.answers[port, CYCLE]
    recorded.answers[port, CYCLE] = [Answer(replace(message, **changes), heard_ns)]
    found = [one for one in judge(recorded, BIT_FOR_BIT) if "sequence" not in one.text]
    assert [(one.requirement, one.message) for one in found] == [(requirement, str(port))]
    assert named in found[0].text


def test_a_command_may_have_spaces_in_its_paths(tmp_path: Path) -> None:
    plan = tmp_path / "two words" / "plan.json"
    device = Device("'/bin/echo' --plan {plan} --node {node}", NODE)
    assert device.words(plan) == ["/bin/echo", "--plan", str(plan), "--node", NODE]
