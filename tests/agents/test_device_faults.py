"""What a device is sent in place of a message."""

from __future__ import annotations

from math import isnan

import msgspec
import pytest

from agents.device_faults import Copy, Damage, DeviceFault, DeviceFaults
from bus_schemas.codec import encode
from bus_schemas.messages import Meter
from bus_schemas.signals import METER
from bus_schemas.tree import ROOT

PORT = METER.of(ROOT)
RIGHT = Meter(7, 0, "plant", (), power_kw=50.0)


def sent(*copies: Copy) -> list[tuple[float, bytes]]:
    return DeviceFaults([DeviceFault("meter", 7, copies)]).sent(PORT, RIGHT)


def test_without_a_fault_it_is_the_message_itself() -> None:
    faults = DeviceFaults([DeviceFault("meter", 8), DeviceFault("dispatch", 7)])
    assert faults.sent(PORT, RIGHT) == [(0.0, encode(RIGHT))]


def test_a_message_is_lost_repeated_held_back_or_changed() -> None:
    assert sent() == []
    assert sent(Copy(), Copy(at=1.2)) == [(0.0, encode(RIGHT)), (1.2, encode(RIGHT))]
    ((_, payload),) = sent(Copy({"power_kw": "nan", "cycle": 9, "source": "nobody"}))
    message = METER.decode(payload)
    assert (message.cycle, message.source, isnan(message.power_kw)) == (9, "nobody", True)


@pytest.mark.parametrize(
    "damage", ["empty", "garbage", "cut", "longer", "list", "no cycle", "no power"]
)
def test_damaged_messages_do_not_decode(damage: Damage) -> None:
    ((_, payload),) = sent(Copy(damage=damage))
    with pytest.raises(msgspec.DecodeError):
        METER.decode(payload)


def test_a_disturbed_link_sends_late_copies_later() -> None:
    put: list[bytes] = []
    faults = DeviceFaults([DeviceFault("meter", 7, (Copy(at=1.0), Copy()))])
    faults.disturbed(PORT, put.append, lambda cycle: 1 << 62)(encode(RIGHT))
    assert put == [encode(RIGHT)], "the late one waits"
    faults.disturbed(PORT, put.append, lambda cycle: 0)(encode(RIGHT))
    while len(put) < 3:
        pass
    assert put == [encode(RIGHT)] * 3
