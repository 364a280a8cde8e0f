"""Says that something takes long: by a spinner in a terminal, elsewhere by a line now and then."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from rich.console import Console

_FIRST_S: Final = 3.0
_NEXT_S: Final = 15.0
"""Without a terminal, time from one line to the next."""


@contextmanager
def busy(console: Console, what: str, first_s: float = _FIRST_S) -> Iterator[None]:
    """Say what is being done, for as long as it takes.

    Without a terminal the first line comes after `first_s`.
    """
    if console.is_terminal:
        with console.status(what):
            yield
        return
    is_done, began_at = threading.Event(), time.monotonic()

    def tell() -> None:
        wait_s = first_s
        while not is_done.wait(wait_s):
            wait_s = _NEXT_S
            spent_s = time.monotonic() - began_at
            console.print(f"{what}: {spent_s:.0f} s so far", highlight=False, markup=False)

    thread = threading.Thread(target=tell, daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_done.set()
        thread.join()
