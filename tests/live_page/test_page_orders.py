"""Orders from the page: what gets through, and all that does not."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from order_desks import obeying_plant
from plans_by_hand import plan_of
from served import Served, served

from sim_plant.order_desk import OrderLine, PlantStatus

PLAN = plan_of({"a": 200.0, "b": 200.0}, cycles=10_000)
ORDER = json.dumps({"power_kw": 250.0}).encode()


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Served]:
    with obeying_plant(tmp_path, PLAN), served(tmp_path, orders=True) as page:
        yield page


def source_of_order(folder: Path) -> str:
    with OrderLine(folder) as line:
        statuses = (one for one in line.heard() if isinstance(one, PlantStatus))
        next(statuses)  # It may be of the cycle before.
        return next(statuses).dispatch.order_source


def test_the_page_orders_a_power_and_the_way_back_and_is_told_how_the_plant_answers(
    page: Served, tmp_path: Path
) -> None:
    status, text = page.order(ORDER)
    reply, *progress, settled = text.splitlines()
    assert status == 200
    assert progress[0] == "delivers 250 kW of 250 kW, 1.0 s after the order"
    assert reply.startswith("in force from cycle ")
    assert settled == "250 kW reached within 1 % after 1.0 s, overshoot 0.0 %"
    assert source_of_order(tmp_path) == "page"
    status, text = page.order(json.dumps({"power_kw": None, "ramp_kw_per_min": 6e3}).encode())
    assert (status, text.splitlines()[-1].partition(" reached")[0]) == (200, "100 kW")


def test_the_way_back_works_while_a_ramp_goes_on(page: Served, tmp_path: Path) -> None:
    ramp = json.dumps({"power_kw": 250.0, "ramp_kw_per_min": 0.1}).encode()
    with page.opened_order(ramp) as answer:
        assert answer.readline().startswith(b"in force from cycle ")
        status, text = page.order(json.dumps({"power_kw": None}).encode())
        assert (status, text.splitlines()[-1].partition(" reached")[0]) == (200, "100 kW")
        *progress, last = answer.read().splitlines()
        assert b"asked for now: 100 kW" in progress[0]
        assert b"then another order came" in last


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"method": "GET"}, 405),
        ({"method": "PUT"}, 405),
        ({"Cookie": ""}, 403),
        ({"Cookie": "heliarch-page=wrong"}, 403),
        ({"Origin": ""}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({"Content-Type": "text/plain"}, 403),
        ({"Content-Type": "application/x-www-form-urlencoded"}, 403),
    ],
)
def test_a_request_that_is_not_of_the_page_orders_nothing(
    page: Served, tmp_path: Path, changes: dict[str, str], expected: int
) -> None:
    assert page.order(ORDER, **changes)[0] == expected
    assert source_of_order(tmp_path) == ""


@pytest.mark.parametrize(
    "body",
    [
        b'{"power_kw": -1}',
        b'{"power_kw": 401}',
        b'{"power_kw": NaN}',
        b'{"power_kw": "250"}',
        b'{"power_kw": 250, "ramp_kw_per_min": 0}',
        b'{"power_kw": 250, "hold_s": -1}',
        b'{"source": "modbus", "power_kw": 250}',
        b'{"power_kw": "\xff"}',
        b"{}",
        b"x" * 2_000,
    ],
)
def test_a_bad_order_is_refused_in_a_line(page: Served, tmp_path: Path, body: bytes) -> None:
    status, text = page.order(body)
    assert status == 422
    assert len(text.splitlines()) == 1
    assert source_of_order(tmp_path) == ""


def test_a_page_without_orders_takes_none(tmp_path: Path) -> None:
    with obeying_plant(tmp_path, PLAN), served(tmp_path) as page:
        assert page.order(ORDER)[0] in {404, 405}
        with OrderLine(tmp_path) as line:
            line.give("command", power_kw=50.0)
        assert source_of_order(tmp_path) == "command"
