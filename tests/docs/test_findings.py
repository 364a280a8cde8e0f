"""Tables that name tests name tests that there are."""

from __future__ import annotations

import csv
import re

import pytest
from running import REPOSITORY

TABLES = REPOSITORY / "docs" / "tables"


@pytest.mark.parametrize("table", ["attacked", "findings", "planted-by-others"])
def test_each_test_and_page_that_a_table_names_is_there(table: str) -> None:
    with (TABLES / f"{table}.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    assert rows
    for *_, places in rows:
        for path, test in re.findall(r"((?:tests|docs)/\S+\.\w+)(?:::(\w+))?", places):
            text = (REPOSITORY / path).read_text(encoding="utf-8")
            assert not test or re.search(rf"^def {test}\(", text, re.MULTILINE), places
