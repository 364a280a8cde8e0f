"""Whose messages listeners lack."""

from __future__ import annotations

import pytest
from plans_by_hand import REAL_TIME, plan_of

from bus_schemas.codec import encode
from bus_schemas.messages import Head, Impp
from recordings.record.reach import Reach


@pytest.mark.parametrize(("external", "missed"), [((), ["plant"]), (("c1/a",), [])])
def test_what_a_device_says_that_it_lacks_opens_nobodys_session_anew(
    external: tuple[str, ...], missed: list[str]
) -> None:
    plan = plan_of({"c1/a": 100.0, "c1/b": 100.0}, cycle_wall_ns=REAL_TIME, external=external)
    reach = Reach(plan, 0)
    message = Impp(7, 0, "c1/a", ("c1/a/telemetry",), power_kw=50.0, stale_cycles=9)
    reach.hear(Head(7, "c1/a"), encode(message), 1)
    assert reach.missed(2) == missed
