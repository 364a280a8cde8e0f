"""JUnit XML, in which the rows of a result are test cases for a laboratory's CI."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from bus_schemas.errors import InputError


class Case(NamedTuple):
    """A row of a result: its failure and why it was skipped, both empty if it passed."""

    name: str
    failure: str = ""
    skipped: str = ""


def check_junit(file: Path | None) -> None:
    """Refuse the option before any work where the library is not installed."""
    if file is not None and find_spec("junitparser") is None:
        expected = "expected junitparser: pip install 'heliarch[junit]'"
        raise InputError.of("--junit", expected)


def write_junit(file: Path | None, suites: Mapping[str, Iterable[Case]]) -> None:
    """Write the cases of each suite, if a file is named."""
    if file is None:
        return
    import junitparser

    document = junitparser.JUnitXml()
    for name, cases in suites.items():
        suite = junitparser.TestSuite(name)
        for case in cases:
            entry = junitparser.TestCase(case.name, classname=name)
            if case.failure:
                entry.result = [junitparser.Failure(case.failure)]
            elif case.skipped:
                entry.result = [junitparser.Skipped(case.skipped)]
            suite.add_testcase(entry)
        document.add_testsuite(suite)
    document.write(str(file), pretty=True)
