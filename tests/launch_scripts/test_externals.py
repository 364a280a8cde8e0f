"""What an external agent finds: its place in the plan, its ports, and the plan as a whole."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from agents.plan_file import load_plan
from bus_schemas.errors import InputError
from bus_schemas.tcp_ports import reserved_ports
from launch_scripts.run_folder import RunFolder
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import load_scenario


def test_the_plan_names_them_in_the_order_of_the_tree() -> None:
    node, oahu = "c1/inv01", load_scenario("oahu")
    device = RunOptions(duration="10", external=[node, "plant", "c1", node], base_port=7500)
    plan = prepare(oahu, device, "run-1").plan
    assert plan.access.external == ("plant", "c1", node)
    assert plan.bus_namespace == "oahu", "a device is configured once"


def test_ports_begin_with_the_base_port_and_must_be_free() -> None:
    with reserved_ports(("recorder", "plant")) as found:
        first = found["recorder"]
    with reserved_ports(("recorder",), first) as found:
        assert found == {"recorder": first}
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken = server.getsockname()[1]
        complaint = f"--base-port: expected .* port {taken} of recorder"
        with pytest.raises(InputError, match=complaint), reserved_ports(("recorder",), taken):
            pass


def test_a_plan_appears_whole_after_all_that_it_refers_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = RunFolder(tmp_path / "run")
    there_before: list[str] = []

    def replaced(source: Path, target: Path) -> None:
        there_before.extend(sorted(path.name for path in target.parent.iterdir()))
        source.rename(target)

    monkeypatch.setattr(Path, "replace", replaced)
    preparation = prepare(load_scenario("oahu"), RunOptions(duration="10"), "run-1")
    plan = folder.fill(preparation, {"plant": 7501})
    finished = [name for name in there_before if not name.endswith(".unfinished")]
    assert finished == ["logs", "profile.npz", "scenario.toml"]
    assert load_plan(folder.plan) == plan
