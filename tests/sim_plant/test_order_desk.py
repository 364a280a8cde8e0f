"""The desk in a run's folder: who may give orders there, and what a wrong order does."""

from __future__ import annotations

import socket
import stat
from pathlib import Path

import msgspec
from order_desks import obeying_plant
from plans_by_hand import plan_of

from sim_plant.order_desk import SOCKET_NAME, OrderLine, PlantStatus, short_path

HEAD = b'{"cycle": 0, "sim_time_ns": 0, "missing": [], '

PLAN = plan_of({"a": 200.0}, cycles=1_000)


def answered(line: OrderLine) -> PlantStatus:
    return next(status for status in line.statuses() if status.answer)


def test_its_socket_is_for_the_owner_alone_and_goes_with_the_run(tmp_path: Path) -> None:
    folder = tmp_path / ("long" * 40)  # Longer than the path of a socket may be.
    folder.mkdir()
    with obeying_plant(folder, PLAN):
        found = (folder / SOCKET_NAME).stat().st_mode
        assert stat.S_ISSOCK(found)
        assert stat.S_IMODE(found) == 0o600
        with OrderLine(folder) as line:
            line.give("command", power_kw=50.0)
            assert answered(line).dispatch.power_kw == 50.0
    assert not (folder / SOCKET_NAME).exists()


def test_a_wrong_order_is_refused_and_the_next_one_obeyed(tmp_path: Path) -> None:
    with (
        obeying_plant(tmp_path, PLAN),
        short_path(tmp_path) as path,
        OrderLine(tmp_path) as line,
        socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as raw,
    ):
        raw.connect(path)
        for wrong in (
            b'{"power_kw": 0.0}',
            HEAD + b'"source": "scenario", "power_kw": 0.0}',
            HEAD + b'"source": "command", "power_kw": NaN}',
            HEAD + b'"source": "command", "power_kw": 1e40}',
            HEAD + b'"source": "command", "power_kw": 0.0, "ramp_kw_per_min": 0}',
            b"\xff" * 4_000,
        ):
            raw.send(wrong)
            told = msgspec.json.decode(raw.recv(4_096), type=PlantStatus)
            while not told.answer:
                told = msgspec.json.decode(raw.recv(4_096), type=PlantStatus)
            assert told.answer.startswith("refused: ")
            assert not told.dispatch.order_source
        line.give("page", power_kw=50.0)
        assert answered(line).dispatch.power_kw == 50.0


def test_of_two_orders_in_one_cycle_one_is_taken_and_the_other_giver_is_told(
    tmp_path: Path,
) -> None:
    with obeying_plant(tmp_path, PLAN), OrderLine(tmp_path) as one, OrderLine(tmp_path) as other:
        for number in range(200):
            one.give("command", power_kw=float(number))
            other.give("modbus", power_kw=float(number))
            found = {answered(one).answer, answered(other).answer}
            if len(found) == 2:
                assert any(text.startswith("replaced at once") for text in found)
                return
        raise AssertionError("no two orders met")
