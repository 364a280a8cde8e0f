"""The queue between Zenoh's thread, which calls us, and an agent's."""

from __future__ import annotations

import ctypes
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from typing import Final, TypeAlias

import zenoh

from bus_schemas.bus import Cause
from bus_schemas.messages import Message
from bus_schemas.signals import Occurrence, Port
from bus_schemas.wiring import Bundle

Source: TypeAlias = Port[Message] | Bundle
Item: TypeAlias = tuple[Source, bytes, int]

_NEVER: Final = 1 << 60

_CROWDED: Final = 10_000
"""From this many waiting messages on, each port has a limit: one port must not take all memory."""

_MOST_OF_A_PORT: Final = 100

_this_thread = threading.local()


class Inbox:
    """A queue from Zenoh's thread to the agent's: wakes the agent once, when enough has arrived.

    dropped: Messages that could not be read or found no room, by port and cause.
    on_enough: Called on Zenoh's thread. By default it wakes the agent's.
    """

    def __init__(self) -> None:
        self.dropped: Counter[tuple[str, str]] = Counter()
        self.on_enough: Callable[[], object] = self.wake
        self._waiting: Counter[Source] = Counter()
        self._items: deque[Item | None] = deque()
        self._wanted = _NEVER
        self._urgent = False
        self._gate = threading.Lock()
        self._gate.acquire()

    def callback(self, source: Source) -> Callable[[zenoh.Sample], None]:
        """Return what takes in the messages of a port; a bundle counts as all that it may hold."""
        items, extend, now_ns = self._items, self._items.extend, time.monotonic_ns
        urgent = isinstance(source, Port) and source.signal.occurrence is Occurrence.EVENT
        more = (None,) * (0 if isinstance(source, Port) else len(source.ports) - 1)

        def receive(sample: zenoh.Sample) -> None:
            if not hasattr(_this_thread, "is_kept"):
                # Otherwise Python makes and discards a state of Zenoh's thread for each callback:
                # an eighth of the processor time of a cycle.
                ctypes.pythonapi.PyGILState_Ensure()
                _this_thread.is_kept = True
            if len(items) >= _CROWDED and not self._has_room(source):
                return
            # A payload that is kept keeps the buffer of its batch: 64 kB, mapped anew for the next.
            extend(((source, sample.payload.to_bytes(), now_ns()), *more))
            if len(items) >= self._wanted or urgent:
                self._wanted = _NEVER
                self._urgent = self._urgent or urgent
                self.on_enough()

        return receive

    def want(self, wanted: int) -> bool:
        """Ask for a call at this many messages or an urgent one; return whether they are there."""
        self._wanted = wanted
        # The last one may have come just before that.
        return len(self._items) >= wanted or (self._urgent and bool(self._items))

    def sleep(self, timeout_s: float) -> None:
        if timeout_s > 0.0:
            self._gate.acquire(timeout=timeout_s)

    def wake(self) -> None:
        with suppress(RuntimeError):  # Two messages at once: it is awake already.
            self._gate.release()

    def take(self, wanted: int = 0, timeout_s: float = 0.0) -> list[Item]:
        until = time.monotonic() + timeout_s
        # The gate may still be open from messages that were taken already.
        while timeout_s > 0.0 and not self.want(wanted):
            self.sleep(timeout_s)
            timeout_s = until - time.monotonic()
        self._wanted = _NEVER
        self._urgent = False
        if self._waiting:
            self._waiting = Counter()
        items, taken = self._items, []
        while items:
            if (item := items.popleft()) is not None:
                taken.append(item)
        return taken

    def _has_room(self, source: Source) -> bool:
        self._waiting[source] += 1
        if self._waiting[source] <= _MOST_OF_A_PORT:
            return True
        self.dropped[str(source), Cause.FLOODED] += 1
        return False
