"""The one line with which bad input is refused."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from bus_schemas.errors import InputError


def complaint_of(call: Callable[..., object], *args: object, **options: object) -> str:
    """Call what refuses its input; return its one line."""
    with pytest.raises(InputError) as caught:
        call(*args, **options)
    (line,) = str(caught.value).splitlines()
    return line
