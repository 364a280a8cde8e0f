"""Work for workers, in a module that takes them no time to import."""

from __future__ import annotations

import os
import signal
import time

from bus_schemas.errors import InputError


def die_on_three(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def refuse_three(number: int) -> int:
    if number == 3:
        raise InputError("expected no 3")
    return number


def sleep_for(item: tuple[float, bytes]) -> None:
    time.sleep(item[0])
