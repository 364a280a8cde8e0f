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


def found(recorded: DeviceRun) -> list[tuple[str, tuple[str, str]]]:
    return [(one.requirement, one.what) for one in judge(recorded, BIT_FOR_BIT)]


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
    assert finding.what == ("", "late")
    assert "answered 950 ms late" in finding.text


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"power_kw": 1.0}, ("", ("residual", "power_kw"))),
        ({"power_kw": 1e6}, ("bounds", ("residual", "bounds"))),
        ({"sim_time_ns": 7}, ("head", ("residual", "sim_time_ns"))),
        ({"incarnation": 2}, ("head", ("residual", "incarnation"))),
        ({"publish_time_ns": 1 << 60}, ("head", ("residual", "times"))),
    ],
)
def test_a_wrong_field_fails_one_requirement(
    recorded: DeviceRun, changes: dict[str, float], expected: tuple[str, tuple[str, str]]
) -> None:
    ((message, heard_ns),) = recorded.answers[RESIDUAL.of(NODE), CYCLE]
    recorded.answers[RESIDUAL.of(NODE), CYCLE] = [Answer(replace(message, **changes), heard_ns)]
    others = [one for one in found(recorded) if one != ("head", ("residual", "sequence"))]
    assert others == [expected]


def test_a_command_may_have_spaces_in_its_paths(tmp_path: Path) -> None:
    plan = tmp_path / "two words" / "plan.json"
    device = Device("'/bin/echo' --plan {plan} --node {node}", NODE)
    assert device.words(plan) == ["/bin/echo", "--plan", str(plan), "--node", NODE]
