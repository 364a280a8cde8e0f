"""Messages to bytes and back: the wire is plain msgpack, and bad payloads are refused."""

from __future__ import annotations

import math
from itertools import product

import msgpack
import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from bus_schemas.codec import decode, encode, json_schema
from bus_schemas.messages import (
    LONGEST_MISSING,
    LONGEST_TEXT,
    MOST_MISSING,
    HelpGiven,
    Impp,
    Message,
    Residual,
)
from bus_schemas.signals import IMPP, RESIDUAL, SIGNALS, Signal
from bus_schemas.tree import LONGEST_PATH, MOST_CHILDREN, MOST_INVERTERS

HEAD_FIELDS = [
    *("cycle", "sim_time_ns", "source", "missing"),
    *("ready_time_ns", "publish_time_ns", "sequence", "incarnation"),
]

KW = st.floats(allow_nan=False)
CLOCK_NS = st.integers(0, 2**62 - 1)
COUNT = st.integers(0, 2**32 - 1)
KWS = st.lists(KW, max_size=5).map(tuple)

FIELDS: dict[str, st.SearchStrategy[object]] = {
    "cycle": st.integers(1 - 2**31, 10**18 - 1),
    "sim_time_ns": st.integers(-(2**62), 2**62 - 1),
    "source": st.text(max_size=LONGEST_PATH),
    "missing": st.lists(st.text(max_size=LONGEST_MISSING), max_size=3).map(tuple),
    "ready_time_ns": CLOCK_NS,
    "publish_time_ns": CLOCK_NS,
    "sequence": COUNT,
    "incarnation": COUNT,
    "available_kw": st.none() | KW,
    "revert_kw": st.none() | KW,
    "stale_cycles": COUNT,
    "start_time_ns": CLOCK_NS,
    "cycle_wall_ns": CLOCK_NS,
    "count": COUNT,
    "protocol": COUNT,
    "state": st.sampled_from(["start", "stop"]),
    "text": st.text(max_size=LONGEST_TEXT),
    "paused": st.booleans(),
    "inverter_mpp_kw": KWS,
    "inverter_power_kw": KWS,
    "stage": st.sampled_from(["report", "solve"]),
    **dict.fromkeys(("correction_kw", "wanted_kw", "metered_kw"), st.none() | KW),
    **dict.fromkeys(("readings", "meter_cycle", "clamped"), st.none() | COUNT),
    "help_given": st.lists(
        st.builds(HelpGiven, st.text(max_size=LONGEST_PATH), KW), max_size=4
    ).map(tuple),
}

each_signal = pytest.mark.parametrize("signal", SIGNALS, ids=lambda signal: signal.name)


def messages(signal: Signal[Message]) -> st.SearchStrategy[Message]:
    fields = {name: FIELDS.get(name, KW) for name in signal.type.__struct_fields__}
    return st.fixed_dictionaries(fields).map(lambda values: msgspec.convert(values, signal.type))


def one(signal: Signal[Message]) -> Message:
    """A plain message of a signal."""
    plain: dict[str, object] = {
        **dict.fromkeys(HEAD_FIELDS, 1),
        **{"source": "c1", "missing": ("c1/inv07/impp",), "stale_cycles": 0, "count": 1},
        **{"state": "start", "start_time_ns": 5, "cycle_wall_ns": 0, "text": "words"},
        "protocol": 1,
        **{"inverter_mpp_kw": (1.0, 2.0), "inverter_power_kw": (0.5, 2.0)},
        **{"help_given": (HelpGiven("c1/inv08", 12.5),), "paused": True},
        **{"stage": "solve", "readings": 1, "meter_cycle": 1, "clamped": 1},
    }
    names = signal.type.__struct_fields__
    return msgspec.convert({name: plain.get(name, 1.5) for name in names}, signal.type)


def required(signal: Signal[Message]) -> set[str]:
    """Fields that may not be left out."""
    return {field.name for field in msgspec.structs.fields(signal.type) if field.required}


@each_signal
@settings(max_examples=30)
@given(data=st.data())
def test_what_is_sent_is_what_arrives(signal: Signal[Message], data: st.DataObject) -> None:
    message = data.draw(messages(signal))
    assert decode(signal, encode(message)) == message


def test_a_power_that_is_no_number_arrives_as_it_is() -> None:
    arrived = decode(RESIDUAL, encode(Residual(1, 2, "c1", (), power_kw=math.nan)))
    assert math.isnan(arrived.power_kw)


@each_signal
def test_the_wire_is_one_plain_msgpack_map_from_field_name_to_value(
    signal: Signal[Message],
) -> None:
    message = one(signal)
    found = msgpack.unpackb(encode(message))
    assert list(found)[: len(HEAD_FIELDS)] == HEAD_FIELDS
    assert found == msgspec.json.decode(msgspec.json.encode(message))
    assert decode(signal, msgpack.packb(found)) == message, "as another library packs it"


@each_signal
def test_a_field_too_many_is_refused(signal: Signal[Message]) -> None:
    fields = {**msgpack.unpackb(encode(one(signal))), "voltage_v": 1.0}
    with pytest.raises(msgspec.DecodeError, match="unknown field `voltage_v`"):
        decode(signal, msgpack.packb(fields))


@each_signal
def test_a_field_too_few_is_refused(signal: Signal[Message]) -> None:
    whole = msgpack.unpackb(encode(one(signal)))
    for name in required(signal):
        fields = {key: value for key, value in whole.items() if key != name}
        with pytest.raises(msgspec.DecodeError, match=f"missing required field `{name}`"):
            decode(signal, msgpack.packb(fields))


@each_signal
def test_a_field_of_the_wrong_type_is_refused(signal: Signal[Message]) -> None:
    whole = msgpack.unpackb(encode(one(signal)))
    for name in whole:
        with pytest.raises(msgspec.DecodeError, match=rf"at `\$\.{name}`"):
            decode(signal, msgpack.packb({**whole, name: {}}))


@each_signal
def test_a_whole_number_that_cannot_be_counted_with_is_refused(signal: Signal[Message]) -> None:
    whole = msgpack.unpackb(encode(one(signal)))
    names = [name for name, value in whole.items() if type(value) is int]
    assert {"cycle", "sim_time_ns", "publish_time_ns", "sequence"} <= set(names)
    for name, number in product(names, (-(2**62) - 1, 2**62, 2**64 - 1)):
        with pytest.raises(msgspec.DecodeError, match=rf"at `\$\.{name}`"):
            decode(signal, msgpack.packb({**whole, name: number}))


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
        decode(IMPP, msgpack.packb({**whole, field: value}))


def test_all_inputs_of_the_largest_tree_can_be_named() -> None:
    # A parent waits for impp, residual and help of each child, and for its own parent's words.
    assert max(3 * MOST_CHILDREN + 2, MOST_INVERTERS) < MOST_MISSING, "and one more: skipped@CYCLE"
    longest = max(len(signal.name) for signal in SIGNALS if signal.is_cyclic)
    cycle = str(10**18 - 1)
    assert LONGEST_PATH + len("/") + longest + len("@") + len(cycle) <= LONGEST_MISSING


@pytest.mark.parametrize(
    "payload",
    [
        *(b"", b"\xc1", b"\x81", msgpack.packb([1, 2, 3])),
        encode(Impp(0, 0, "c1/ab", (), power_kw=1.0, stale_cycles=0)).replace(b"ab", b"\xff\xfe"),
    ],
)
def test_garbage_is_refused(payload: bytes) -> None:
    with pytest.raises(msgspec.DecodeError):
        decode(IMPP, payload)


@each_signal
def test_the_json_schema_accepts_what_msgpack_reads_and_nothing_else(
    signal: Signal[Message],
) -> None:
    schema = json_schema(signal)
    assert schema["type"] == "object", "viewers look at the root"
    validator = Draft202012Validator(schema)
    whole = msgpack.unpackb(encode(one(signal)))
    validator.validate(whole)
    assert not validator.is_valid({**whole, "voltage_v": 1.0})
    for name in whole:
        assert not validator.is_valid({**whole, name: {}})
        fields = {key: value for key, value in whole.items() if key != name}
        assert validator.is_valid(fields) == (name not in required(signal))
