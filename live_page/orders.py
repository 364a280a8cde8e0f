"""Orders from the page: a document that says whether it may, and one that takes them.

Only a run that was started with `--orders` takes them, by a POST of the page itself: from the same
origin, with the token, which such a page has on the loopback address too.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Annotated, Final

import msgspec
from msgspec import Meta
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from agents.plan import load_plan
from bus_schemas.errors import FailureError, InputError
from bus_schemas.tree import ROOT
from results.live_answer import answer_text, watched
from sim_plant.order_desk import OrderLine

_LARGEST_BYTES: Final = 1_000


class _Asked(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the page asks for. No power: back to the schedule."""

    power_kw: Annotated[float, Meta(ge=0.0)] | None
    ramp_kw_per_min: Annotated[float, Meta(gt=0.0, le=1e12)] | None = None


def order_route(folder: Path) -> Route:
    """Return the route that takes the orders for the run in a folder."""

    async def take(request: Request) -> Response:
        if not _is_same_origin(request):
            return PlainTextResponse("expected a request of the page itself\n", 403)
        try:
            asked = msgspec.json.decode(await _body(request), type=_Asked)
            return PlainTextResponse(await asyncio.to_thread(_give, folder, asked))
        except (msgspec.DecodeError, InputError, FailureError) as error:
            return PlainTextResponse(f"{error}\n", 422)

    return Route("/order", take, methods=["POST"])


def _give(folder: Path, asked: _Asked) -> str:
    """Give an order; return in a line how the plant answered."""
    plan = load_plan(folder / "plan.json")
    rating_kw = plan.tree.rating_kw(ROOT)
    if asked.power_kw is not None and asked.power_kw > rating_kw:
        raise InputError(f"power: expected up to {rating_kw:,.10g} kW, got {asked.power_kw:,.10g}")
    with OrderLine(folder) as line:
        line.give("page", power_kw=asked.power_kw, ramp_kw_per_min=asked.ramp_kw_per_min)
        found, remark = watched(line.statuses(), plan)
    return answer_text(found) + remark


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
