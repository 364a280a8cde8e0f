"""Serves the page: plain files, a few documents, and a stream of updates for each browser.

Everything happens in one thread, and only while a browser asks. A slow browser skips updates. A
browser can ask, but not command, unless the run was started with `--orders`.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from math import isfinite
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import (
    FileResponse,
    HTMLResponse,
    PlainTextResponse,
    Response,
    StreamingResponse,
)
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from bus_schemas.errors import InputError
from live_page.process import PageAddress
from live_page.run_list import recordings_in, run_list
from live_page.run_view import RunView

_STATIC: Final = Path(__file__).with_name("static")
_MOST_CONNECTIONS: Final = 100
_STALLED_S: Final = 30.0
"""A browser that takes nothing for this long is let go: its laptop may sleep."""

_OPEN_RUNS: Final = 4
_CONTENT_POLICY: Final = "Content-Security-Policy"
_OWN_FILES_ONLY: Final = "default-src 'self'"
"""What a page may load, unless the response says otherwise."""

_ONE_FILE_ONLY: Final = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)
"""The same of a comparison: nothing but what is in it."""

_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class EventStream(StreamingResponse):
    """Server-sent events. A browser that takes none of them for a while is let go."""

    media_type = "text/event-stream"

    async def stream_response(self, send: Send) -> None:
        async def send_in_time(message: Message) -> None:
            async with asyncio.timeout(_STALLED_S):
                await send(message)

        with suppress(TimeoutError):
            await super().stream_response(send_in_time)


class _Server(uvicorn.Server):
    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals to the command."""
        yield


class PageServer:
    """The server of one run, or of the `several` runs in a folder; `orders`: it takes them.

    `streams` counts the browsers that look on; `left_at` is when the last one left.
    """

    def __init__(
        self, path: Path, address: PageAddress, *, several: bool, orders: bool = False
    ) -> None:
        self.streams = 0
        self.left_at = float("-inf")
        self._address = address
        self._path = path
        self._several = several
        self._orders = orders
        self._opened = lru_cache(_OPEN_RUNS)(RunView)
        self._server = _Server(
            uvicorn.Config(
                self._app(),
                log_config=None,
                log_level="error",
                access_log=False,
                lifespan="off",
                ws="none",
                limit_concurrency=_MOST_CONNECTIONS,
                server_header=False,
                headers=list(_HEADERS.items()),
                timeout_graceful_shutdown=1,
            )
        )

    async def serve(self) -> None:
        await self._server.serve(sockets=[self._address.socket])

    def end(self) -> None:
        self._server.should_exit = True

    def _app(self) -> ASGIApp:
        of_run = [
            Route("/", self._file("run.html")),
            Route("/plan", self._plan),
            Route("/window", self._window),
            Route("/node", self._node),
            Route("/stream", self._stream),
            Route("/metrics", self._metrics),
            Route("/no-help", self._without_help),
            Route("/clouds", self._clouds),
        ]
        routes: list[BaseRoute] = [Mount("/static", StaticFiles(directory=_STATIC))]
        if not self._several:
            routes += of_run
            if self._orders:
                from live_page.orders import order_route  # noqa: PLC0415 - numpy is slow to import

                routes.append(order_route(self._path))
        else:
            routes += [
                Route("/", self._file("runs.html")),
                Route("/runs", self._runs),
                Route("/compare", self._compare),
                Mount("/run/{run}", routes=of_run),
            ]
        middleware = [Middleware(_Guard, token=self._address.token, cookie=self._cookie)]
        if not self._address.token:
            # Another site's page must not reach this one under a name of its own.
            own = self._address.socket.getsockname()[0]
            hosts = ["127.0.0.1", "localhost", "[::1]", own, f"[{own}]"]
            middleware.insert(0, Middleware(TrustedHostMiddleware, allowed_hosts=hosts))
        errors: Any = {InputError: _bad_input}
        return Starlette(routes=routes, middleware=middleware, exception_handlers=errors)

    @property
    def _cookie(self) -> str:
        """Name of the cookie with the token: browsers keep one jar for all ports of a host."""
        return f"heliarch-page-{self._address.socket.getsockname()[1]}"

    def _file(self, name: str) -> Callable[[Request], Awaitable[Response]]:
        async def answer(request: Request) -> Response:
            page, token = FileResponse(_STATIC / name), self._address.token
            if token:
                page.set_cookie(self._cookie, token, httponly=True, samesite="strict")
            return page

        return answer

    def _view(self, request: Request) -> RunView:
        """Return the run that a request is about. Of several runs a few stay open."""
        if not self._several:
            return self._opened(self._path)
        return self._opened(self._recording(request.path_params["run"]))

    def _recording(self, name: str) -> Path:
        path = recordings_in(self._path).get(name)
        if path is None:
            raise InputError(f"{name}: no run of that name in {self._path}")
        return path

    async def _runs(self, request: Request) -> Response:
        return _json(run_list(self._path))

    async def _compare(self, request: Request) -> Response:
        """Return the comparison of two runs as a page of its own, which holds all that it needs."""
        names = [request.query_params.get(one, "") for one in "ab"]
        paths = [self._recording(name) for name in names]
        ways = [(name.replace("~", "/"), f"run/{quote(name, safe='')}/") for name in names]
        return await asyncio.to_thread(_comparison, paths, [("all runs", "./"), *ways])

    async def _without_help(self, request: Request) -> Response:
        """Return the comparison of a run with what its sky would have given without help."""
        ways = [("all runs", "../../")] if self._several else []
        path = self._view(request).path
        return await asyncio.to_thread(_comparison, [path], [*ways, ("this run", "./")])

    async def _plan(self, request: Request) -> Response:
        plan = self._view(request).plan()
        return _json(plan and plan | {"takes_orders": self._orders})

    async def _window(self, request: Request) -> Response:
        points = int(_number(request, "points", 1000))
        return _json(self._view(request).window(_cycles(request), points))

    async def _node(self, request: Request) -> Response:
        node = request.query_params.get("path", "")
        return _json(await self._view(request).node(node, _cycles(request)))

    async def _clouds(self, request: Request) -> Response:
        from live_page.sky import clouds  # noqa: PLC0415 - scipy is slow to import

        follower, _ = await self._view(request).newest()
        return _json(clouds(follower.run, int(_number(request, "cycle", 0))))

    async def _metrics(self, request: Request) -> Response:
        """Return the newest cycle for Prometheus, which reads the recording on meanwhile."""
        try:
            from live_page.metrics import CONTENT_TYPE, metrics_text  # noqa: PLC0415 - an extra
        except ModuleNotFoundError as error:
            text = f"{error.name} is not installed: pip install 'heliarch[metrics]'\n"
            return PlainTextResponse(text, 501)
        content = metrics_text(*await self._view(request).newest())
        return Response(content, headers={"Content-Type": CONTENT_TYPE})

    async def _stream(self, request: Request) -> Response:
        """Follow the newest cycle, or play from the cycle `from` at a `speed`."""
        begin = _number(request, "from", -1.0)
        speed = max(_number(request, "speed", 0.0), 0.0)
        view = self._view(request)
        return EventStream(self._events(view.updates(None if begin < 0 else begin, speed)))

    async def _events(self, updates: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
        self.streams += 1
        try:
            async for update in updates:
                yield b"data: " + update + b"\n\n"
                if self._server.should_exit:
                    return
        finally:
            self.streams -= 1
            self.left_at = asyncio.get_running_loop().time()


class _Guard:
    """Admits only requests that have the token, and says what their pages may load."""

    def __init__(self, app: ASGIApp, token: str, cookie: str) -> None:
        self._app = app
        self._token = token
        self._cookie = cookie

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return
        request = Request(scope)
        given = request.query_params.get("token") or request.cookies.get(self._cookie, "")
        if self._token and not secrets.compare_digest(given.encode(), self._token.encode()):
            refusal = PlainTextResponse("the address needs the token that was printed\n", 403)
            await refusal(scope, receive, send)
            return

        async def send_with_policy(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).setdefault(_CONTENT_POLICY, _OWN_FILES_ONLY)
            await send(message)

        await self._app(scope, receive, send_with_policy)


def _comparison(recordings: list[Path], links: list[tuple[str, str]]) -> Response:
    """Compare two runs, or one with its baseline; a page with a way back, also if it cannot."""
    # Plotly is for this page alone: the others do not wait for it.
    from results.report.page import html_page  # noqa: PLC0415
    from results.report.result import Result  # noqa: PLC0415
    from results.two_runs import diff_runs, with_and_without_help  # noqa: PLC0415

    status = 200
    try:
        first, last = recordings[0], recordings[-1]
        result = diff_runs((first, last)) if last is not first else with_and_without_help(first)
    except InputError as error:
        status, result = 422, Result("These runs cannot be compared", (), None, lines=[str(error)])
    page = html_page(replace(result, links=links))
    return HTMLResponse(page, status, headers={_CONTENT_POLICY: _ONE_FILE_ONLY})


def _json(document: object) -> Response:
    return Response(msgspec.json.encode(document), media_type="application/json")


async def _bad_input(request: Request, error: Exception) -> Response:
    return PlainTextResponse(f"{error}\n", 404)


def _number(request: Request, name: str, default: float) -> float:
    text = request.query_params.get(name, default)
    with suppress(ValueError):
        if isfinite(value := float(text)):
            return value
    raise InputError(f"{name}: expected a number, got {text}")


def _cycles(request: Request) -> range:
    """Return the cycles that a request asks for: `from` to `to`, both included."""
    return range(int(_number(request, "from", 0)), int(_number(request, "to", 1e12)) + 1)
