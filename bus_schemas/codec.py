"""Messages to bytes and back: plain msgpack, one map for each message."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final

import msgspec

from bus_schemas.messages import Head, Message
from bus_schemas.signals import Signal

encode: Final[Callable[[Message], bytes]] = msgspec.msgpack.Encoder().encode
"""Returns a message as a msgpack map."""

decode_head: Final[Callable[[bytes], Head]] = msgspec.msgpack.Decoder(Head).decode
"""Returns the head of a message of any signal, or raises one of `UNREADABLE`."""

UNREADABLE: Final = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)
"""Errors of decoders."""

encode_bundle: Final[Callable[[Sequence[tuple[str, Message]]], bytes]] = (
    msgspec.msgpack.Encoder().encode
)
"""Returns keys and messages as a msgpack array of pairs."""

_heads_of_bundle = msgspec.msgpack.Decoder(list[tuple[str, Head]])
_parts_of_bundle = msgspec.msgpack.Decoder(list[tuple[str, msgspec.Raw]])


def open_bundle(payload: bytes) -> Iterator[tuple[str, Head, bytes]]:
    """Yield key, head and payload of each message in a bundle, or raise one of `UNREADABLE`."""
    heads, parts = _heads_of_bundle.decode(payload), _parts_of_bundle.decode(payload)
    return ((key, head, bytes(part)) for (key, head), (_, part) in zip(heads, parts, strict=True))


def json_schema(signal: Signal[Message]) -> dict[str, object]:
    """JSON Schema of a signal's messages, with the type at its root, where viewers look for it."""
    schema = msgspec.json.schema(signal.type)
    definitions = schema.pop("$defs")
    root = definitions.pop(schema.pop("$ref").rsplit("/", 1)[-1])
    return {**root, **({"$defs": definitions} if definitions else {})}
