"""Messages to bytes and back: plain msgpack, one map for each message."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeVar

import msgspec

from bus_schemas.messages import LARGEST_PAYLOAD, Head, Message
from bus_schemas.signals import SIGNALS, Signal

M = TypeVar("M", bound=Message)
T = TypeVar("T")

encode: Final[Callable[[Message], bytes]] = msgspec.msgpack.Encoder().encode
"""Returns a message as a msgpack map."""

_decoders: dict[type[Message], msgspec.msgpack.Decoder[Any]] = {
    signal.type: msgspec.msgpack.Decoder(signal.type) for signal in SIGNALS
}


_heads = msgspec.msgpack.Decoder(Head)


def decode(signal: Signal[M], payload: bytes) -> M:
    """Return the message that a payload of a signal holds, or raise msgspec.DecodeError."""
    if len(payload) > LARGEST_PAYLOAD:
        raise msgspec.DecodeError(f"{len(payload)} bytes are more than {LARGEST_PAYLOAD}")
    decoder: msgspec.msgpack.Decoder[M] = _decoders[signal.type]
    try:
        return decoder.decode(payload)
    except (UnicodeDecodeError, RecursionError) as error:
        raise _undecodable(error) from None


def decode_head(payload: bytes) -> Head:
    """Return the head of a message of any signal, or raise msgspec.DecodeError."""
    return _decoded(_heads, payload)


def decode_json(data: bytes, type_: type[T]) -> T:
    """Return what JSON from outside holds, or raise msgspec.DecodeError."""
    return _decoded(msgspec.json.Decoder(type_), data)


def _decoded(decoder: msgspec.msgpack.Decoder[T] | msgspec.json.Decoder[T], payload: bytes) -> T:
    try:
        return decoder.decode(payload)
    except (UnicodeDecodeError, RecursionError) as error:
        raise _undecodable(error) from None


def _undecodable(error: UnicodeDecodeError | RecursionError) -> msgspec.DecodeError:
    """Return what an error of a decoder means that is no DecodeError."""
    if isinstance(error, UnicodeDecodeError):
        return msgspec.DecodeError(f"invalid UTF-8 in a string: {error.reason}")
    return msgspec.DecodeError("lists or maps are nested too deep")


def json_schema(signal: Signal[Message]) -> dict[str, object]:
    """JSON Schema of a signal's messages, with the type at its root, where viewers look for it."""
    schema = msgspec.json.schema(signal.type)
    definitions = schema.pop("$defs")
    root = definitions.pop(schema.pop("$ref").rsplit("/", 1)[-1])
    return {**root, **({"$defs": definitions} if definitions else {})}
