"""Messages to bytes and back: the wire is plain msgpack, and bad payloads are refused."""

from __future__ import annotations

from itertools import product

import msgpack
import msgspec
import pytest
from jsonschema import Draft202012Validator

from bus_schemas.codec import UNREADABLE, encode, json_schema
from bus_schemas.messages import (
    LONGEST_MISSING,
    MOST_MISSING,
    HelpGiven,
    Impp,
    Message,
    Missing,
    parse_missing,
)
from bus_schemas.signals import IMPP, SIGNALS, Signal
from bus_schemas.tree import LONGEST_PATH

HEAD_FIELDS = [
    *("cycle", "sim_time_ns", "source", "missing"),
    *("ready_time_ns", "publish_time_ns", "sequence", "incarnation"),
]

each_signal = pytest.mark.parametrize("signal", SIGNALS, ids=lambda signal: signal.name)


def one(signal: Signal[Message]) -> Message:
    """A plain message of a signal."""
    plain: dict[str, object] = {
        **dict.fromkeys(HEAD_FIELDS, 1),
        **{"source": "c1", "missing": ("c1/inv07/impp",), "stale_cycles": 0, "count": 1},
        **{"state": "start", "start_time_ns": 5, "cycle_wall_ns": 0, "text": "words"},
        "protocol": 4,
        **{"order_source": "page", "order_state": "holds", "order_cycle": 1, "order_renewed": 1},
        **{"inverter_mpp_kw": (1.0, 2.0), "inverter_power_kw": (0.5, 2.0)},
        "help_given": (HelpGiven("c1/inv08", 12.5),),
        **{"stage": "solve", "readings": 1, "meter_cycle": 1, "clamped": 1, "agents": ("c1/a",)},
        **{"offers": (0.5, 0.25), "expected_kw": (0.5, 0.25), "order_replaced": ("page",)},
        **{"intervals": 1, "record": (0.5,)},
        **{"storage_power_kw": (-1.0,), "storage_energy_kwh": (2.0,)},
    }
    names = signal.type.__struct_fields__
    return msgspec.convert({name: plain.get(name, 1.5) for name in names}, signal.type)


@each_signal
def test_the_wire_is_one_plain_msgpack_map_from_field_name_to_value(
    signal: Signal[Message],
) -> None:
    message = one(signal)
    found = msgpack.unpackb(encode(message))
    assert list(found)[: len(HEAD_FIELDS)] == HEAD_FIELDS
    assert found == msgspec.json.decode(msgspec.json.encode(message))
    assert signal.decode(msgpack.packb(found)) == message, "as another library packs it"


@each_signal
def test_a_whole_number_that_cannot_be_counted_with_is_refused(signal: Signal[Message]) -> None:
    whole = msgpack.unpackb(encode(one(signal)))
    names = [name for name, value in whole.items() if type(value) is int]
    assert {"cycle", "sim_time_ns", "publish_time_ns", "sequence"} <= set(names)
    largest = {**whole, "cycle": 10**18 - 1, "publish_time_ns": 2**62 - 1}
    assert signal.decode(msgpack.packb(largest)).cycle == 10**18 - 1
    for name, number in product(names, (-(2**62) - 1, 2**62, 2**64 - 1)):
        with pytest.raises(msgspec.DecodeError, match=rf"at `\$\.{name}`"):
            signal.decode(msgpack.packb({**whole, name: number}))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("missing", ["c1/inv07/impp", "x" * (LONGEST_MISSING + 1)]),
        ("missing", ["c1/inv07/impp"] * (MOST_MISSING + 1)),
        ("source", "x" * (LONGEST_PATH + 1)),
    ],
)
def test_more_than_any_agent_can_say_is_refused(field: str, value: object) -> None:
    whole = msgpack.unpackb(encode(one(IMPP)))
    with pytest.raises(msgspec.DecodeError, match=rf"at `\$\.{field}"):
        IMPP.decode(msgpack.packb({**whole, field: value}))


@pytest.mark.parametrize(
    "payload",
    [
        *(b"", b"\xc1", b"\x81", msgpack.packb([1, 2, 3])),
        *(b"\xdd" + b"\xff" * 4, b"\xdf" + b"\xff" * 4, b"\x81\xa6source\xdb" + b"\xff" * 4),
        b"\x81\xa7missing\xdd" + b"\xff" * 4,
        encode(Impp(0, 0, "c1/ab", (), power_kw=1.0, stale_cycles=0)).replace(b"ab", b"\xff\xfe"),
    ],
)
def test_garbage_is_refused(payload: bytes) -> None:
    with pytest.raises(UNREADABLE):
        IMPP.decode(payload)


@each_signal
def test_a_payload_and_its_json_schema_refuse_the_same_fields(signal: Signal[Message]) -> None:
    """Those too many, those too few, and those of the wrong type."""
    schema = json_schema(signal)
    assert schema["type"] == "object", "viewers look at the root"
    validator = Draft202012Validator(schema)
    whole = msgpack.unpackb(encode(one(signal)))
    validator.validate(whole)
    wrong = {"unknown field `voltage_v`": {**whole, "voltage_v": 1.0}}
    for field in msgspec.structs.fields(signal.type):
        wrong[rf"at `\$\.{field.name}`"] = {**whole, field.name: {}}
        fewer = {key: value for key, value in whole.items() if key != field.name}
        if field.required:
            wrong[f"missing required field `{field.name}`"] = fewer
        else:
            validator.validate(fewer)
            signal.decode(msgpack.packb(fewer))
    for complaint, fields in wrong.items():
        assert not validator.is_valid(fields), complaint
        with pytest.raises(msgspec.DecodeError, match=complaint):
            signal.decode(msgpack.packb(fields))


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ("c1/inv07/impp", Missing("c1/inv07/impp", None)),
        ("c1/inv07/impp@41", Missing("c1/inv07/impp", 41)),
        ("c1/impp@-3", Missing("c1/impp@-3", None)),
        ("c1/impp@" + "9" * 18, Missing("c1/impp", 10**18 - 1)),
        ("c1/impp@1" + "0" * 18, Missing("c1/impp@1" + "0" * 18, None)),
        ("c1/impp@\u0661\u0662", Missing("c1/impp@\u0661\u0662", None)),
    ],
)
def test_an_entry_is_a_key_with_or_without_a_cycle(entry: str, expected: Missing) -> None:
    assert parse_missing(entry) == expected
    assert str(parse_missing(entry)) == entry
