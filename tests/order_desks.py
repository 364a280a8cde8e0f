"""A plant that does at once what it is ordered, at the desk in a run's folder."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from agents.plan import RunPlan
from bus_schemas.tree import ROOT
from sim_plant.order_desk import OrderDesk, PlantStatus
from sim_plant.orders import BEFORE_RUN, Orders

SCHEDULED_KW = 100.0


@contextmanager
def obeying_plant(folder: Path, plan: RunPlan, able_kw: float = 1e9) -> Iterator[None]:
    """Let a plant take orders in a folder, with that plan and a hundred cycles a second."""
    (folder / "plan.json").write_bytes(plan.as_json())
    over = threading.Event()
    with OrderDesk(folder, plan.tree.rating_kw(ROOT)) as desk:
        thread = threading.Thread(target=_obey, args=(desk, plan, able_kw, over), daemon=True)
        thread.start()
        yield
        over.set()
        thread.join()


def _obey(desk: OrderDesk, plan: RunPlan, able_kw: float, over: threading.Event) -> None:
    orders, cycle = Orders(plan), 0
    dispatch = orders.scheduled(BEFORE_RUN, SCHEDULED_KW, 0.0)
    while not over.is_set():
        scheduled = orders.scheduled((cycle, *BEFORE_RUN[1:]), SCHEDULED_KW, 0.0)
        dispatch = orders.next(dispatch, desk.take(), scheduled)
        desk.answer(dispatch)
        delivered_kw = min(dispatch.power_kw, able_kw)
        desk.tell(PlantStatus(dispatch=dispatch, available_kw=able_kw, delivered_kw=delivered_kw))
        cycle += 1
        time.sleep(0.01)
