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
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from agents.events import Status
from agents.plan import RunPlan
from bus_schemas.printable import printable

_PLAIN_S: Final = 2.0
_IN_PLACE_S: Final = 0.1

_BAR_WIDTH: Final = 50
_NAMED: Final = 6
"""How many nodes in need are named before the rest is counted."""


def view_for(console: Console, plan: RunPlan) -> View:
    """Choose the live panel for a terminal, plain lines for anything else."""
    return LivePanel(console, plan) if console.is_terminal else View(console, plan)


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


class View:
    """Shows a run: a line every now and then."""

    def __init__(self, console: Console, plan: RunPlan) -> None:
        self._console = console
        self._plan = plan
        self._zone = ZoneInfo(plan.timezone)
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
            f"{self.local_time(status)} cycle {status.cycle + 1}/{self._plan.cycles} "
            f"desired {status.desired_kw:.0f} kW, delivered {status.delivered_kw:.0f} kW, "
            f"possible {status.possible_kw:.0f} kW; help: {_needy(status)}"
        )


class LivePanel(View):
    """A panel that is drawn anew a few times a second."""

    def __init__(self, console: Console, plan: RunPlan) -> None:
        super().__init__(console, plan)
        self._rating_kw = sum(rating_kw for _, rating_kw in plan.inverters)
        self._progress = Progress(
            TextColumn("cycle"),
            MofNCompleteColumn(),
            BarColumn(bar_width=None),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeRemainingColumn(),
            console=console,
        )
        self._task = self._progress.add_task("run", total=plan.cycles)
        self._live = Live(console=console, refresh_per_second=8, transient=True)

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._live.stop()

    def show(self, status: Status) -> None:
        if status.cycle < 0:
            return
        self._progress.update(self._task, completed=status.cycle + 1)
        powers = Table.grid(padding=(0, 1))
        powers.add_column(width=10)
        powers.add_column(justify="right", width=11)
        powers.add_column()
        for name, power_kw, style in (
            ("desired", status.desired_kw, "yellow"),
            ("delivered", status.delivered_kw, "green"),
            ("possible", status.possible_kw, "cyan"),
        ):
            bar = ProgressBar(
                self._rating_kw, power_kw, _BAR_WIDTH, complete_style=style, finished_style=style
            )
            powers.add_row(name, f"{power_kw:,.0f} kW", bar)
        needy = Text(f"needs help: {_needy(status)}", style="red" if status.needy else "dim")
        title = f"{self._plan.plant} {self.local_time(status)}"
        subtitle = f"{status.recorded:,} messages recorded"
        body = Group(powers, needy, self._progress)
        self._live.update(Panel(body, title=Text(title), subtitle=subtitle, width=90))


def _needy(status: Status) -> str:
    # A cluster that lacks power contains inverters that do: the clusters come first.
    nodes = sorted(status.needy, key=lambda node: (node.count("/"), node))
    named = ", ".join(node or "the whole plant" for node in nodes[:_NAMED])
    rest = len(nodes) - _NAMED
    return f"{named} and {rest} more" if rest > 0 else named or "nobody"
