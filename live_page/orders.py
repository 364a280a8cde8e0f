"""Orders from the page: a document that says whether it may, and one that takes them.

Only a run that was started with `--orders` takes them, by a POST of the page itself: from the same
origin, with the token, which such a page has on the loopback address too.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Final

import msgspec
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route

from agents.plan_file import load_plan
from bus_schemas.codec import UNREADABLE
from bus_schemas.errors import FailureError, InputError
from results.live_answer import LiveAnswer
from sim_plant.order_desk import OrderLine
from sim_plant.orders import PAGE

_LARGEST_BYTES: Final = 1_000


class _Asked(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the page asks for. No power: back to the schedule."""

    power_kw: float | None
    ramp_kw_per_min: float | None = None
    hold_s: float | None = None


def order_route(folder: Path) -> Route:
    """Return the route that takes the orders for the run in a folder."""

    async def take(request: Request) -> Response:
        if not _is_same_origin(request):
            return PlainTextResponse("expected a request of the page itself\n", 403)
        try:
            asked = msgspec.json.decode(await _body(request), type=_Asked)
            lines = _lines(folder, asked)
            reply, is_in_force = await asyncio.to_thread(next, lines)
        except (*UNREADABLE, InputError, FailureError) as error:
            return PlainTextResponse(f"{error}\n", 422)
        if not is_in_force:
            return PlainTextResponse(f"{reply}\n", 422)
        return StreamingResponse(_texts(request, reply, lines), media_type="text/plain")

    return Route("/order", take, methods=["POST"])


def _lines(folder: Path, asked: _Asked) -> Iterator[tuple[str, bool]]:
    """Give an order; yield the reply, in each cycle how far the plant is, and how it settled.

    Each with whether the order is in force.
    """
    plan = load_plan(folder / "plan.json")
    found = LiveAnswer(plan)
    with OrderLine(folder, plan.timing.cycle_wall_ns / 1e9) as line:
        line.give(PAGE, **msgspec.structs.asdict(asked))
        for text in found.lines(line.heard()):
            if found.reply is not None:
                yield text or found.progress, found.reply.is_in_force


async def _texts(
    request: Request, reply: str, lines: Iterator[tuple[str, bool]]
) -> AsyncIterator[str]:
    """Yield the lines of a response while the page is there."""
    yield f"{reply}\n"
    try:
        while found := await asyncio.to_thread(next, lines, None):
            if found[0]:
                yield f"{found[0]}\n"
            if await request.is_disconnected():
                return
    except FailureError as error:
        yield f"{error}\n"


def _is_same_origin(request: Request) -> bool:
    """Whether a page of this server sends the request, as browsers say of every POST."""
    headers = request.headers
    is_own = headers.get("origin") == f"http://{headers.get('host')}"
    is_json = headers.get("content-type") == "application/json"
    return is_own and is_json and headers.get("sec-fetch-site", "same-origin") == "same-origin"


async def _body(request: Request) -> bytes:
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _LARGEST_BYTES:
            raise InputError(f"expected up to {_LARGEST_BYTES} bytes")
    return body
