"""The messages of a recording, decoded, with what the file notes about each: when, which number."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import msgspec

from bus_schemas.codec import decode
from bus_schemas.errors import InputError
from bus_schemas.messages import Message
from bus_schemas.signals import Port, Signal
from recordings.read.reader import RunReader
from recordings.record.writer import ClockAnchor

_TELL_EVERY: Final = 4096
"""Records between two words of progress."""


class Record(NamedTuple):
    """A message as it stands in a recording.

    Attributes
    ----------
    port, message
        What it is about, and what it says.
    log_time_ns, publish_time_ns
        Wall clock when it was recorded and when it was published, ns since 1970-01-01 UTC.
    sequence
        Its number on its key.
    """

    port: Port[Message]
    message: Message
    log_time_ns: int
    publish_time_ns: int
    sequence: int


@dataclass(frozen=True, slots=True)
class Selection:
    """The part of a recording that is wanted.

    Attributes
    ----------
    signals
        Which signals.
    nodes
        About which nodes; none given: about all.
    cycles
        Which cycles; None: all that there is, the word that the run is over too, which carries the
        number of the cycle after the last one.
    """

    signals: tuple[Signal[Message], ...]
    nodes: tuple[str, ...] = ()
    cycles: range | None = None


def records(
    reader: RunReader, selection: Selection, progress: Callable[[float], None]
) -> Iterator[Record]:
    """Yield the records of a selection, in the order of the file.

    Parameters
    ----------
    reader
        The recording. Of one that was cut, everything up to the cut is found.
    selection
        What is wanted of it.
    progress
        Called now and then with the share of the file that has been read, in [0, 1].

    Raises
    ------
    InputError
        A message does not decode, or the file is damaged.
    """
    ports = reader.ports(*selection.signals, nodes=selection.nodes)
    for number, raw in enumerate(reader.records(ports, selection.cycles, by_time=False)):
        if number % _TELL_EVERY == 0:
            progress(reader.read_share)
        try:
            message = decode(raw.port.signal, raw.payload)
        except msgspec.DecodeError as error:
            raise InputError(
                f"{raw.port} number {raw.sequence}: {error}, accepted is a "
                f"{raw.port.signal.type.__name__}"
            ) from None
        yield Record(raw.port, message, raw.log_time_ns, raw.publish_time_ns, raw.sequence)
    progress(1.0)


def clock_anchor(reader: RunReader) -> ClockAnchor:
    """Return the pair of clock readings that a recording's times were derived from.

    Raises
    ------
    InputError
        The recording has none.
    """
    told = reader.metadata.get("clock_anchor", {})
    try:
        return ClockAnchor(int(told["monotonic_ns"]), int(told["wall_ns"]))
    except (KeyError, ValueError):
        raise InputError(
            f"metadata clock_anchor is {told}, accepted are monotonic_ns and wall_ns"
        ) from None
