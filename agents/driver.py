"""The one driver: runs agents over a bus (Zenoh, memory, a recording) and by a clock, if any."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from heapq import heappop, heappush
from itertools import count
from typing import Any

from agents.loop import Loop
from bus_schemas.bus import Arrival, Bus
from bus_schemas.messages import Message
from bus_schemas.signals import Port


class Driver:
    """Some agents of a run, on one bus.

    closed: How many stages they have closed.
    """

    def __init__(self, loops: Iterable[Loop[Any]], bus: Bus, now_ns: Callable[[], int]) -> None:
        self.loops = {loop.name: loop for loop in loops}
        self.bus = bus
        self.now_ns = now_ns
        # The numbers order deadlines of one moment.
        self._numbers = count()
        self._deadlines: list[tuple[int, int, str]] = []
        self._deadline_of: dict[str, int | None] = dict.fromkeys(self.loops)
        self.closed = 0

    def leave(self, name: str) -> Loop[Any]:
        return self.loops.pop(name)

    def join(self, loop: Loop[Any]) -> None:
        self.loops[loop.name] = loop
        self._deadline_of[loop.name] = None
        loop.catch_up(self.now_ns())
        self.advance(loop)

    @property
    def finished(self) -> bool:
        return all(loop.cycle >= loop.times.end_cycle for loop in self.loops.values())

    def run(self) -> Iterator[Sequence[Arrival]]:
        """Go on to the end of the run; yield, after each wait, the messages that came."""
        for loop in self.loops.values():
            self.advance(loop)
        while not self.finished:
            yield self.wait_and_act()

    def wait_and_act(self, longest_ns: int | None = None) -> Sequence[Arrival]:
        """Wait for messages, a deadline or `longest_ns`, and act; return the messages."""
        arrivals = self.bus.receive(self._until_ns(longest_ns), self._wanted)
        self._act_on(arrivals)
        # In memory all messages of a moment come before its deadlines.
        self._close_overdue(self.now_ns() - bool(arrivals))
        return arrivals

    def stop(self) -> None:
        """Act on nothing more that comes."""

    def advance(self, loop: Loop[Any], *, is_overdue: bool = False) -> None:
        """Close an overdue stage and all complete ones; publish the outputs."""
        bus, now_ns = self.bus, self.now_ns
        while is_overdue or not loop.waiting:
            sent = loop.close_stage(now_ns(), is_overdue=is_overdue)
            if sent is None:
                break
            is_overdue = False
            self.closed += 1
            for port, message in sent:
                bus.publish(port, message, now_ns())
        deadline_ns = loop.deadline_ns
        if deadline_ns is not None and deadline_ns != self._deadline_of[loop.name]:
            self._deadline_of[loop.name] = deadline_ns
            heappush(self._deadlines, (deadline_ns, next(self._numbers), loop.name))

    def publish(self, port: Port[Message], message: Message) -> None:
        self.bus.publish(port, message, self.now_ns())

    @property
    def _wanted(self) -> int:
        """The least number of messages that lets one of the agents go on."""
        least = 0
        for loop in self.loops.values():  # A generator would cost more than all its steps.
            waiting = len(loop.waiting)
            if waiting and (waiting < least or not least):
                least = waiting
        return least or 1

    def _until_ns(self, longest_ns: int | None) -> int | None:
        until_ns = self._next_deadline_ns()
        if until_ns is None or (longest_ns is not None and longest_ns < until_ns):
            return longest_ns
        return until_ns

    def _act_on(self, arrivals: Sequence[Arrival]) -> None:
        if self._deadlines:
            self._catch_up()
        for agent, port, message, time_ns in arrivals:
            loop = self.loops[agent]
            loop.hear(port, message, time_ns)
            if not loop.waiting or loop.deadline_ns != self._deadline_of[agent]:
                self.advance(loop)

    def _next_deadline_ns(self) -> int | None:
        while self._deadlines:
            deadline_ns, _, name = self._deadlines[0]
            loop = self.loops.get(name)
            if loop is not None and loop.deadline_ns == deadline_ns:
                return deadline_ns
            heappop(self._deadlines)  # That stage is closed, or its agent gone.
        return None

    def _catch_up(self) -> None:
        """Take agents whose cycle is over to the cycle under way."""
        while (deadline_ns := self._next_deadline_ns()) is not None and deadline_ns < self.now_ns():
            loop = self.loops[self._deadlines[0][2]]
            if not loop.catch_up(self.now_ns()):
                return
            self.advance(loop)

    def _close_overdue(self, now_ns: int) -> None:
        """Close the stage with the earliest deadline, if that is over."""
        deadline_ns = self._next_deadline_ns()
        if deadline_ns is not None and deadline_ns <= now_ns:
            self.advance(self.loops[heappop(self._deadlines)[2]], is_overdue=True)
