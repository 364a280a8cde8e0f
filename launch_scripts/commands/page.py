"""`--page`: a run in a browser, while it goes on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from rich.console import Console

from bus_schemas.errors import InputError
from launch_scripts.commands.options import PageOptions
from launch_scripts.commands.output import say
from live_page.process import PageProcess


@contextmanager
def page_beside(options: PageOptions, console: Console) -> Iterator[PageProcess | None]:
    """Start the page of a command, if it is wanted; at the end, wait until nobody looks at it."""
    if options.page:
        with PageProcess(options.page_address, options.page_port) as page:
            yield page
            page.let_end(partial(say, console))
        return
    for option, given in (
        ("--page-address", options.page_address),
        ("--page-port", options.page_port),
    ):
        if given is not None:
            raise InputError(f"{option}: expected --page with it")
    yield None
