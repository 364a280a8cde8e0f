"""A plant that does at once what it is ordered, at the desk in a run's folder."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from agents.agent import Turn
from agents.plan import RunPlan
from bus_schemas.tree import ROOT
from sim_plant.order_desk import OrderDesk, PlantStatus
from sim_plant.orders import Orders, Wanted

SCHEDULED_KW = 100.0


@contextmanager
def obeying_plant(folder: Path, plan: RunPlan, able_kw: float = 1e9) -> Iterator[None]:
    """Let a plant take orders in a folder, with that plan and a hundred cycles a second."""
    (folder / "plan.json").write_bytes(plan.as_json())
    over = threading.Event()
    with OrderDesk(folder) as desk:
        thread = threading.Thread(target=_obey, args=(desk, plan, able_kw, over), daemon=True)
        thread.start()
        yield
        over.set()
        thread.join()


def _obey(desk: OrderDesk, plan: RunPlan, able_kw: float, over: threading.Event) -> None:
    orders = Orders((), plan.timing.cycle_s, plan.tree.rating_kw(ROOT))
    wanted, cycle = Wanted(SCHEDULED_KW), 0
    while not over.is_set():
        given = desk.take(Turn("sense", cycle, 0, (cycle, 0, "plant", (), 0, 0, 0, 0), {}))
        wanted = orders.next(wanted, given, SCHEDULED_KW, cycle)
        desk.tell(
            PlantStatus(
                cycle=cycle,
                dispatch_kw=wanted.power_kw,
                available_kw=able_kw,
                delivered_kw=min(wanted.power_kw, able_kw),
                order=wanted.order,
                is_there=wanted.is_there,
            )
        )
        cycle += 1
        time.sleep(0.01)
