"""What is printed on a console of a given width."""

from __future__ import annotations

import io
from collections.abc import Callable

from rich.console import Console


def printed(show: Callable[[Console], object], width: int = 100) -> str:
    """Return what a function prints on the console that it is given."""
    text = io.StringIO()
    show(Console(file=text, width=width))
    return text.getvalue()
