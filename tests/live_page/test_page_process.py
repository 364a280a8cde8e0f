"""The page beside a run is a process that ends with it."""

from __future__ import annotations

import json
import time
import urllib.error
import urllib.request

import pytest
from running import Start
from served import page_of

pytestmark = pytest.mark.processes


def answers(page: str) -> bool:
    try:
        urllib.request.urlopen(f"{page}plan", timeout=20).close()
    except (urllib.error.URLError, ConnectionError):
        return False
    return True


@pytest.mark.parametrize("command", ["launch", "simulate"])
def test_a_run_that_nobody_looks_at_ends_as_without_a_page(
    command: str, heliarch: Start, plant: str
) -> None:
    run = heliarch(command, plant, "--duration", "40", "--pace", "10", "--page")
    page = page_of(run)
    with urllib.request.urlopen(f"{page}stream", timeout=60) as updates:
        news = (json.loads(line[6:]) for line in updates if line.startswith(b"data: "))
        assert next(one for one in news if one.get("cycle", -1) >= 5)["frame"]["nodes"]["power"]
    assert run.wait() == 0
    assert not answers(page)


def test_the_page_ends_with_a_launcher_that_is_killed(heliarch: Start, plant: str) -> None:
    run = heliarch("launch", plant, "--pace", "10", "--page")
    page = page_of(run)
    assert answers(page)
    run.process.kill()
    give_up_at = time.monotonic() + 30.0
    while answers(page):
        assert time.monotonic() < give_up_at
        time.sleep(0.1)
