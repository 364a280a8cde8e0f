"""The view of a run in progress: a live panel in a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from datetime import datetime
from typing import IO, Final, Self
from zoneinfo import ZoneInfo

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from agents.plan import RunPlan
from agents.process.events import Status
from bus_schemas.errors import listed, printable

_PLAIN_S: Final = 2.0
_IN_PLACE_S: Final = 0.1
_NAMED: Final = 6


def view_for(console: Console, plan: RunPlan) -> PlainView:
    """Choose the live panel for a terminal, plain lines for anything else."""
    return LivePanel(console, plan) if console.is_terminal else PlainView(console, plan)


class StatusLine:
    """Where a run or a replay stands, as one line: renewed in place, or printed every 2 s."""

    def __init__(self, stream: IO[str], *, in_place: bool) -> None:
        self._stream = stream
        self._in_place = in_place
        self._next_at = 0.0
        self._shown = ""

    def is_due(self) -> bool:
        """Whether the shown line is old enough."""
        return time.monotonic() >= self._next_at

    def show(self, text: str) -> None:
        self._next_at = time.monotonic() + (_IN_PLACE_S if self._in_place else _PLAIN_S)
        if text != self._shown:
            self._stream.write(f"\r\x1b[K{text}" if self._in_place else f"{text}\n")
            self._stream.flush()
            self._shown = text

    def end(self) -> None:
        """Leave the line as it is, and go on below it."""
        if self._shown and self._in_place:
            self._stream.write("\n")
            self._stream.flush()


class PlainView:
    """Shows a run as a line every 2 s."""

    def __init__(self, console: Console, plan: RunPlan) -> None:
        self._console = console
        self._plan = plan
        self._zone = ZoneInfo(plan.timing.timezone)
        self._line = StatusLine(console.file, in_place=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def local_time(self, status: Status) -> str:
        return f"{datetime.fromtimestamp(status.sim_time_ns / 1e9, self._zone):%H:%M:%S}"

    def say(self, text: str) -> None:
        """Show a line that stays."""
        self._console.print(printable(text), highlight=False, soft_wrap=True, markup=False)

    def show(self, status: Status) -> None:
        """Show where the run stands, if the last line about it is old enough."""
        if status.cycle < 0 or not self._line.is_due():
            return
        self._line.show(
            f"{self.local_time(status)} {status.cycle + 1} of {self._plan.timing.cycles} cycles, "
            f"dispatch {status.dispatch_kw:.0f} kW, delivered {status.delivered_kw:.0f} kW, "
            f"available {status.available_kw:.0f} kW; help: {_needy(status)}"
        )


class LivePanel(PlainView):
    """A panel that is drawn anew a few times a second."""

    def __init__(self, console: Console, plan: RunPlan) -> None:
        super().__init__(console, plan)
        self._powers = Progress(
            TextColumn("{task.description:10}"),
            TextColumn("{task.completed:>8,.0f} kW"),
            BarColumn(bar_width=50, complete_style="green", finished_style="green"),
        )
        rating_kw = sum(rating_kw for _, rating_kw in plan.inverters)
        for name in ("dispatch", "delivered", "available"):
            self._powers.add_task(name, total=rating_kw)
        self._cycles = Progress(
            MofNCompleteColumn(separator=" of "),
            TextColumn("cycles"),
            BarColumn(bar_width=None),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeRemainingColumn(),
            console=console,
        )
        self._cycles.add_task("run", total=plan.timing.cycles)
        self._live = Live(console=console, refresh_per_second=8, transient=True)

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._live.stop()

    def show(self, status: Status) -> None:
        if status.cycle < 0:
            return
        self._cycles.update(self._cycles.task_ids[0], completed=status.cycle + 1)
        powers_kw = status.dispatch_kw, status.delivered_kw, status.available_kw
        for task, power_kw in zip(self._powers.task_ids, powers_kw, strict=True):
            self._powers.update(task, completed=power_kw)
        needy = Text(f"needs help: {_needy(status)}", style="red" if status.needy else "dim")
        title = f"{self._plan.plant} {self.local_time(status)}"
        subtitle = f"{status.recorded:,} messages recorded"
        body = Group(self._powers, needy, self._cycles)
        self._live.update(Panel(body, title=Text(title), subtitle=subtitle, width=90))


def _needy(status: Status) -> str:
    # A cluster that lacks power contains inverters that do: the clusters come first.
    nodes = sorted(status.needy, key=lambda node: (node.count("/"), node))
    return listed([node or "the whole plant" for node in nodes], _NAMED) or "nobody"
