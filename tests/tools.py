"""Programs that some tests need beside Python: a browser, networks of their own.

Where one is missing the test is skipped, and the last line of the tests names it. With
`HELIARCH_TESTS=all`, as `.ci/run` has it, the test runs, and fails for what is missing.
"""

from __future__ import annotations

import os
import shutil
from typing import Final, NoReturn

import pytest

ALL: Final = os.environ.get("HELIARCH_TESTS") == "all"


def missing(*programs: str) -> str:
    """Return what to say of programs that are not installed; empty if there is nothing to say."""
    found = [program for program in programs if shutil.which(program) is None]
    return "" if ALL or not found else f"{', '.join(found)} not installed"


def not_possible(why: str) -> NoReturn:
    """Skip a test that this machine cannot run, unless all are to run."""
    if ALL:
        pytest.fail(why)
    pytest.skip(why)
