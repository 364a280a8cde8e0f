"""Plants at the desk in a run's folder: one that obeys at once, one that the test drives."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import msgspec
import numpy as np
from plans_by_hand import plan_of

from agents.loop import Loop
from agents.plan import RunPlan
from agents.plan_parts import PlannedOrder
from bus_schemas.messages import Dispatch, Order
from bus_schemas.signals import DISPATCH, ORDER
from bus_schemas.tree import ROOT
from sim_plant.order_desk import OrderDesk, PlantAtDesk, PlantStatus, Reply, short_path
from sim_plant.orders import BEFORE_RUN, Orders
from sim_plant.plant import Plant
from sim_plant.profile import Profile

SCHEDULED_KW = 100.0
RATING_KW, CYCLES = 200.0, 50_000


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


class PlantByHand:
    """A plant at a desk that goes through its cycles when the test says so."""

    def __init__(self, plan: RunPlan, desk: OrderDesk) -> None:
        profile = Profile(np.full((CYCLES, 1), 90.0), np.full(CYCLES, SCHEDULED_KW))
        self.plan = plan
        self.loop = Loop(PlantAtDesk(Plant(plan, profile), desk), plan)
        self.loop.begin(0, 0)

    def go_on(self) -> Dispatch:
        """Go through a cycle; return its dispatch."""
        dispatch = dict(self.loop.close_stage(0, is_overdue=True) or ())[DISPATCH.of(ROOT)]
        self.loop.close_stage(0, is_overdue=True)
        assert isinstance(dispatch, Dispatch)
        return dispatch

    def hear(self, order: Order) -> None:
        self.loop.hear(ORDER.of(ROOT), order, 0)


@contextmanager
def plant_by_hand(folder: Path, *planned: PlannedOrder) -> Iterator[PlantByHand]:
    plan = plan_of({"a": RATING_KW}, cycles=CYCLES, orders=planned)
    with OrderDesk(folder, RATING_KW) as desk:
        yield PlantByHand(plan, desk)


class Giver:
    """A program at a desk that sends what it likes."""

    def __init__(self, folder: Path) -> None:
        self.raw = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.raw.settimeout(30.0)
        with short_path(folder) as path:
            self.raw.connect(path)

    def give(self, source: str, power_kw: float, publish_time_ns: int = 0) -> None:
        stamp = publish_time_ns or time.monotonic_ns()
        order = Order(0, 0, source, (), publish_time_ns=stamp, power_kw=power_kw)
        self.raw.send(msgspec.json.encode(order))

    def arrive(self) -> None:
        """Wait until the desk has read all orders so far: it refuses this one at once."""
        self.raw.send(b"-")
        assert self.reply().text.startswith("refused: ")

    def reply(self) -> Reply:
        while packet := self.raw.recv(8_192):
            found = msgspec.json.decode(packet, type=Reply | PlantStatus)
            if isinstance(found, Reply):
                return found
        raise AssertionError("the desk hung up")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.raw.close()
