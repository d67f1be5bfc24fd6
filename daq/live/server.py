"""The server of the live view: one page and its data, on the loopback interface only.

It runs in a process of its own and only reads the journal or the run file, so that nothing here can slow a recording.
Every path begins with a random token, and a request that names another host or comes from another site is refused: a
page of another site can neither read the data, nor set a marker, nor stop a recording.

::

    GET  /TOKEN/            the page, and its files
    GET  /TOKEN/events      server-sent events (`daq.live.publisher`)
    GET  /TOKEN/stretch     ?from=S&to=S: a stretch of the record, JSON
    POST /TOKEN/marker      text/plain: a marker of this moment
    POST /TOKEN/stop        text/plain "stop", from this page: the recorder ends the recording and keeps the data
"""

import asyncio
import contextlib
import json
import math
import secrets
import socket
from collections.abc import AsyncIterator, Callable
from pathlib import Path

from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from daq.live import assets
from daq.live.publisher import LONGEST_MARKER, FinishedRun, LiveRun, NotPossibleError, Publisher

LOOPBACK = "127.0.0.1"
FAREWELL_S = 1.0  # the server runs for so long after the end, so that pages get the last events
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
# The page at an address that is not a view's; it reveals nothing.
NO_VIEW = """<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>no live view here</title><h1>There is no live view at this address</h1>
<p>The address of a view changes each time one is started. Use the complete address that <code>daq watch</code> or
<code>daq record --live</code> has printed.</p></html>
"""


def create_application(run: Publisher, token: str, host: str, on_end: Callable[[], None]) -> Starlette:
    """Return the web application of a recording or run.

    token: First part of every path.
    host: ``address:port`` of the server: other Host headers are rejected.
    on_end: Called `FAREWELL_S` after the end of the recording.
    """

    async def page(request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        if name not in assets.KINDS:
            return PlainTextResponse("not found", 404)
        return Response(assets.read_content(name), media_type=assets.KINDS[name])

    async def data(request: Request) -> Response:
        last_id = request.headers.get("last-event-id", "")
        first_number = int(last_id) if last_id.isascii() and last_id.isdecimal() else 0
        return StreamingResponse(_stream_events(run, first_number), media_type="text/event-stream")

    async def stretch(request: Request) -> Response:
        try:
            begin, end = (float(request.query_params[name]) for name in ("from", "to"))
        except (KeyError, ValueError):
            return PlainTextResponse("from and to are required, in seconds", 400)
        if not (math.isfinite(begin) and math.isfinite(end)):
            return PlainTextResponse("from and to are required, in seconds", 400)
        text = await asyncio.to_thread(run.stretch, begin, end)
        return Response(text, media_type="application/json")

    async def marker(request: Request) -> Response:
        return await _answer_post(request, run.mark, "the marker could not be stored")

    async def stop(request: Request) -> Response:
        # A browser sends the page's site with every POST; a request without it may not come from a page.
        if "origin" not in request.headers:
            return PlainTextResponse("only the page itself may stop a recording", 403)

        def stop_it(word: str) -> None:
            if word != "stop":
                raise NotPossibleError("say stop")
            run.stop()

        return await _answer_post(request, stop_it, "the recording cannot be stopped from here")

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        async def follow() -> None:
            await run.follow()
            await asyncio.sleep(FAREWELL_S)
            on_end()

        task = asyncio.create_task(follow())
        yield
        task.cancel()

    routes = [
        Route("/", page),
        Route("/events", data),
        Route("/stretch", stretch),
        Route("/marker", marker, methods=["POST"]),
        Route("/stop", stop, methods=["POST"]),
        Route("/{name}", page),
    ]
    inner = Starlette(routes=routes)
    return Starlette(
        routes=[Mount(f"/{token}", inner)], middleware=[Middleware(Guard, host=host, token=token)], lifespan=lifespan
    )


async def _answer_post(request: Request, action: Callable[[str], None], failure: str) -> Response:
    """Call an action with the plain text of a POST, and report whether it succeeded."""
    if request.headers.get("content-type", "").split(";")[0] != "text/plain":
        return PlainTextResponse("send text/plain", 415)
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > 4 * LONGEST_MARKER:
            return PlainTextResponse("the text is too long", 413)
    try:
        action(body.decode(errors="replace"))
    except NotPossibleError as error:
        return PlainTextResponse(str(error), 409)
    except OSError as error:
        return PlainTextResponse(f"{failure}: {error.strerror}", 507)
    return PlainTextResponse("stored")


async def _stream_events(run: Publisher, after: int) -> AsyncIterator[str]:
    """Yield the data for a page: the facts of the run, then its events, each with its number."""
    yield f"retry: 500\nevent: facts\ndata: {json.dumps(run.describe_run())}\n\n"
    async for event in run.events(after):
        yield f"id: {event.number}\ndata: {event.data}\n\n"


class Guard:
    """Reject requests for another host, from another site or without the token; add the headers of every answer."""

    def __init__(self, app: ASGIApp, host: str, token: str) -> None:
        self._app = app
        self._hosts = (host, host.replace(LOOPBACK, "localhost"))
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
            await send(message)

        request = Request(scope)
        origin = request.headers.get("origin")
        first = scope["path"].split("/")[1] if "/" in scope["path"] else ""
        if request.headers.get("host") not in self._hosts:
            await PlainTextResponse("this server answers only its own computer", 421)(scope, receive, send)
        elif origin is not None and origin not in [f"http://{host}" for host in self._hosts]:
            await PlainTextResponse("this page comes from another site", 403)(scope, receive, send)
        elif not secrets.compare_digest(first.encode(), self._token.encode()):
            await Response(NO_VIEW, 404, media_type="text/html")(scope, receive, send_guarded)
        else:
            await self._app(scope, receive, send_guarded)


def serve(path: Path, show: Callable[[str], None]) -> str:
    """Serve the view of a journal until its recording ends, or of a run file; until SIGINT comes.

    ``path`` is the journal (``.part``), or the run file; ``show`` is called with the page's URL when the server accepts
    connections.  Returned is how the recording ended; "" after SIGINT.  Raises InputError if the file is missing, or
    not a journal or run.
    """
    import uvicorn

    run = LiveRun(path) if path.suffix == ".part" else FinishedRun(path)
    token = secrets.token_urlsafe(18)
    with socket.create_server((LOOPBACK, 0)) as listener:
        host = f"{LOOPBACK}:{listener.getsockname()[1]}"
        server: uvicorn.Server

        def stop_server() -> None:
            server.should_exit = True

        config = uvicorn.Config(
            create_application(run, token, host, stop_server),
            log_level="critical",
            access_log=False,
            timeout_graceful_shutdown=1,
            server_header=False,
        )
        server = uvicorn.Server(config)
        show(f"http://{host}/{token}/")
        with contextlib.suppress(KeyboardInterrupt):
            server.run(sockets=[listener])
    if run.failure is not None:
        raise run.failure
    return run.ended
