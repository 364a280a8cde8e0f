"""Reads a recording back as typed messages."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import msgspec
from mcap.exceptions import McapError
from mcap.reader import make_reader

from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.codec import decode
from bus_schemas.errors import InputError
from bus_schemas.signals import Signal
from recordings.writer import RECORDING_NAME, SCHEMA_VERSION


class RunReader:
    """A recording of a run.

    Parameters
    ----------
    path
        The MCAP file, or the folder of a run.

    Raises
    ------
    InputError
        There is no such file, or it is no recording of a run.
    """

    def __init__(self, path: Path) -> None:
        self.path = path / RECORDING_NAME if path.is_dir() else path
        try:
            self._file = self.path.open("rb")
        except FileNotFoundError:
            raise InputError(
                f"{self.path}: no such file, accepted is a run's folder or its {RECORDING_NAME}"
            ) from None
        except OSError as error:
            raise InputError(f"{self.path}: {error.strerror}, accepted is an MCAP file") from None
        try:
            self._read_origin()
        except BaseException:
            self._file.close()
            raise

    def messages(self, *signals: Signal[object]) -> Iterator[Delivery]:  # type: ignore[type-var]
        """Yield the messages in the order of their log time; of all signals, or of these."""
        keys = self.plan.keys
        wanted = {signal.name for signal in signals}
        topics = [
            keys.key(port)
            for port in keys.ports
            if port.signal.logged and (not wanted or port.signal.name in wanted)
        ]
        for _, channel, record in self._reader.iter_messages(topics=topics):
            port = keys.port(channel.topic)
            if port is not None:
                yield port, decode(port.signal, record.data)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> RunReader:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _read_origin(self) -> None:
        try:
            self._reader = make_reader(self._file)
            self.metadata = {entry.name: entry.metadata for entry in self._reader.iter_metadata()}
            attachments = {entry.name: entry.data for entry in self._reader.iter_attachments()}
        except (McapError, OSError, struct.error, ValueError) as error:
            reason = str(error) or type(error).__name__
            raise InputError(f"{self.path}: not a readable MCAP file ({reason})") from None
        self._check_version()
        try:
            self.scenario = attachments["scenario.toml"].decode()
            self.plan = msgspec.json.decode(attachments["plan.json"], type=RunPlan)
        except KeyError as error:
            raise InputError(f"{self.path}: recording without its attachment {error}") from None
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise InputError(f"{self.path}: its attachments do not decode: {error}") from None

    def _check_version(self) -> None:
        found = self.metadata.get("run", {}).get("schema_version")
        if found is None:
            raise InputError(f"{self.path}: an MCAP file, but no recording of a heliarch run")
        if found != SCHEMA_VERSION:
            raise InputError(
                f"{self.path}: schema version {found}, accepted is version {SCHEMA_VERSION}"
            )
