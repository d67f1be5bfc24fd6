"""The server of the live view: one page, its data as server-sent events, and markers, on the loopback interface alone.

It runs in a process of its own and only reads the journal, so that nothing here can slow or stop the recording.  Every
path begins with a random token, and a request that names another host is refused: a page of another site can then
neither read the data nor set a marker.
"""

import asyncio
import contextlib
import json
import math
import os
import secrets
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from daq.base.compute.arrays import Array
from daq.finalise import claim
from daq.live import assets
from daq.live.motion import LiveFilter, LiveMotion
from daq.live.tail import JournalTail
from daq.runfile import journal

LOOPBACK = "127.0.0.1"
# From one look at the journal to the next: the page draws what came in two halves, 20 frames/s.  A look takes 2 to 3 ms
# of CPU time, nearly the same for 50 samples as for 100: half of it takes almost twice the share of a core.
LOOK_EVERY_S = 0.099
ESTIMATE_EVERY_S = 2.0
MOST_PER_S = 1000  # points sent per second of recording: of faster runs every second, third ... sample
HISTORY_S = 120.0  # what a page that connects late, or again, can still be sent
GONE_AFTER_S = 3.0  # a journal that does not grow for so long may have lost its recorder
FAREWELL_S = 1.0  # the server goes on for so long after the end: pages fetch the last events
LONGEST_MARKER = 200  # characters
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


@dataclass(frozen=True)
class PageEvent:
    """One message to the pages: its number, the time of its last sample (s), and its JSON."""

    number: int
    time: float
    data: str


class LiveRun:
    """A recording as the pages see it: the events of the last `HISTORY_S`, and whoever waits for the next one.

    Parameters
    ----------
    path : Path
        The journal.
    """

    def __init__(self, path: Path) -> None:
        self.tail = JournalTail(path)
        self.ended = ""
        self.failure: Exception | None = None
        self._rate_hz = float(self.tail.header["rate_hz"])
        self._filter = LiveFilter(self._rate_hz)
        self._stride = max(1, math.ceil(self._rate_hz / MOST_PER_S))
        self._skip = 0
        self._events: deque[PageEvent] = deque()
        self._number = 0
        self._came = asyncio.Event()
        self._last_new = time.monotonic()
        self._estimated = -math.inf
        self._state = "waiting"
        self._now = 0.0

    async def follow(self) -> None:
        """Look at the journal until the recording has ended; an error ends the view, and is kept in `failure`."""
        due = time.monotonic()
        while not self.ended:
            try:
                self.look()
            except Exception as error:
                self.failure = error
                self._end(f"the view has failed ({error}); the recording goes on")
            now = time.monotonic()
            due = max(due + LOOK_EVERY_S, now)  # a look that is late does not make the next ones follow at once
            await asyncio.sleep(due - now)

    def look(self) -> None:
        """Take what is new in the journal and make an event of it."""
        try:
            new = self.tail.poll()
        except OSError:
            self._end("the recording has ended")
            return
        motions = [self._filter.feed(part) for part in new]
        if new:
            self._last_new, self._now = time.monotonic(), float(new[-1].time[-1])
        if self._last_new - self._estimated >= ESTIMATE_EVERY_S:
            self._estimated = self._last_new
            self._filter.estimate(self.tail.rig)
        for motion in motions:
            self._publish(motion)
        if self.tail.ended:
            words = {journal.COMPLETE: "complete", journal.STOPPED: "stopped by the user"}
            self._end(f"the recording has ended: {words.get(self.tail.ended, self.tail.ended)}")
        elif time.monotonic() - self._last_new > GONE_AFTER_S and not claim.is_locked(self.tail.path):
            self._end(f"the recording process is gone: daq recover {self.tail.path.name}")

    async def events(self, after: int) -> AsyncIterator[PageEvent]:
        """Yield the events after a number, those of the past first, until the recording has ended."""
        while True:
            came = self._came
            for event in [event for event in self._events if event.number > after]:
                after = event.number
                yield event
            if self.ended:
                return
            await came.wait()

    def mark(self, text: str) -> None:
        """Store a marker of this moment beside the journal; the finaliser makes an event of it."""
        words = " ".join(text.split())[:LONGEST_MARKER] or "marker"
        handle = os.open(journal.markers_path(self.tail.path), os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            os.write(handle, f"{time.monotonic_ns()} {words}\n".encode())
        finally:
            os.close(handle)
        self._send({"marker": {"t": self._now, "text": words}})

    def facts(self) -> dict[str, Any]:
        """Return what the page shows about the run before its data."""
        header = self.tail.header
        samples = header["samples"]
        return {
            "title": header["title"],
            "file": self.tail.path.name.removesuffix(".part"),
            "rate": self._rate_hz,
            "duration": None if samples is None else samples / self._rate_hz,
            "every": self._stride,
        }

    def _publish(self, motion: LiveMotion) -> None:
        kept = slice(self._skip, None, self._stride)
        self._skip = (self._skip - motion.time.size) % self._stride
        if motion.time.size:
            last = motion.time.size - 1
            moving = "stick" if motion.stick[last] else "slip" if math.isfinite(motion.v[last]) else "gap"
            self._state = moving if math.isfinite(self._filter.belt_speed) else "moving"
        rig = self.tail.rig
        known = rig.mass is not None and rig.stiffness is not None
        columns = {"t": _column(motion.time[kept], "%.6f")}
        columns |= {name: _column(getattr(motion, name)[kept]) for name in "xva"}
        self._send(
            {
                "counts": vars(self.tail.counts),
                "unit": self.tail.unit,
                "belt": _number(self._filter.belt_speed),
                "k_over_m": _number(self._filter.k_over_m),
                "mass": rig.mass.value if known and rig.mass is not None else None,
                "damping": rig.damping.value if rig.damping is not None else None,
                "state": self._state,
            },
            columns,
        )

    def _send(self, data: dict[str, Any], columns: Mapping[str, str] = MappingProxyType({})) -> None:
        """Keep an event for the pages; ``columns`` are members that are JSON already, by name."""
        self._number += 1
        text = "".join(f', "{name}": {column}' for name, column in columns.items())
        self._events.append(PageEvent(self._number, self._now, json.dumps(data)[:-1] + text + "}"))
        while self._events[0].time < self._now - HISTORY_S:
            self._events.popleft()
        self._came.set()
        self._came = asyncio.Event()

    def _end(self, words: str) -> None:
        self.ended = words
        self._send({"ended": words})


def _number(value: float) -> float | None:
    """Return a number of seven digits for the page; None where it is not known."""
    return float(f"{value:.7g}") if math.isfinite(value) else None


def _column(values: Array, form: str = "%.7g") -> str:
    """Return numbers as a JSON list; null where one is not known."""
    return "[" + ",".join([form % value if math.isfinite(value) else "null" for value in values.tolist()]) + "]"


def application(run: LiveRun, token: str, host: str, finished: Callable[[], None]) -> Starlette:
    """Return the web application.

    Parameters
    ----------
    run : LiveRun
        The recording.
    token : str
        What every path begins with.
    host : str
        ``address:port`` of the server: other Host headers are refused.
    finished : callable
        Called `FAREWELL_S` after the end of the recording.
    """

    async def page(request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        if name not in assets.KINDS:
            return PlainTextResponse("not found", 404)
        return Response(assets.content(name), media_type=assets.KINDS[name])

    async def data(request: Request) -> Response:
        last = request.headers.get("last-event-id", "")
        after = int(last) if last.isascii() and last.isdecimal() else 0
        return StreamingResponse(_stream(run, after), media_type="text/event-stream")

    async def marker(request: Request) -> Response:
        if request.headers.get("content-type", "").split(";")[0] != "text/plain":
            return PlainTextResponse("a marker is text/plain", 415)
        body = b""
        async for part in request.stream():
            body += part
            if len(body) > 4 * LONGEST_MARKER:
                return PlainTextResponse("the marker is too long", 413)
        if run.ended:
            return PlainTextResponse("the recording has ended; use daq note --mark", 409)
        try:
            run.mark(body.decode(errors="replace"))
        except OSError as error:
            return PlainTextResponse(f"the marker could not be stored: {error.strerror}", 507)
        return PlainTextResponse("stored")

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        async def follow() -> None:
            await run.follow()
            await asyncio.sleep(FAREWELL_S)
            finished()

        task = asyncio.create_task(follow())
        yield
        task.cancel()

    routes = [
        Route("/", page),
        Route("/events", data),
        Route("/marker", marker, methods=["POST"]),
        Route("/{name}", page),
    ]
    inner = Starlette(routes=routes)
    return Starlette(
        routes=[Mount(f"/{token}", inner)], middleware=[Middleware(Guard, host=host, token=token)], lifespan=lifespan
    )


async def _stream(run: LiveRun, after: int) -> AsyncIterator[str]:
    """Yield what a page is sent: the facts of the run, then its events, each with its number."""
    yield f"retry: 500\nevent: facts\ndata: {json.dumps(run.facts())}\n\n"
    async for event in run.events(after):
        yield f"id: {event.number}\ndata: {event.data}\n\n"


class Guard:
    """Refuse requests for another host, from another site or without the token; add the headers of every answer."""

    def __init__(self, app: ASGIApp, host: str, token: str) -> None:
        self._app = app
        self._hosts = (host, host.replace(LOOPBACK, "localhost"))
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        origin = request.headers.get("origin")
        first = scope["path"].split("/")[1] if "/" in scope["path"] else ""
        if request.headers.get("host") not in self._hosts:
            await PlainTextResponse("this server is for its own computer", 421)(scope, receive, send)
        elif origin is not None and origin not in [f"http://{host}" for host in self._hosts]:
            await PlainTextResponse("this page is of another site", 403)(scope, receive, send)
        elif not secrets.compare_digest(first.encode(), self._token.encode()):
            await PlainTextResponse("not found", 404)(scope, receive, send)
        else:

            async def send_guarded(message: Message) -> None:
                if message["type"] == "http.response.start":
                    headers = MutableHeaders(scope=message)
                    for name, value in HEADERS.items():
                        headers[name] = value
                await send(message)

            await self._app(scope, receive, send_guarded)


def serve(path: Path, show: Callable[[str], None]) -> str:
    """Serve the live view of a journal until its recording ends or SIGINT comes.

    Parameters
    ----------
    path : Path
        The journal.
    show : callable
        Called with the page's URL when the server accepts connections.

    Returns
    -------
    str
        How the recording ended; "" after SIGINT.

    Raises
    ------
    InputError
        The file is missing, or no journal.
    """
    import uvicorn

    run = LiveRun(path)
    token = secrets.token_urlsafe(18)
    with socket.create_server((LOOPBACK, 0)) as listening:
        host = f"{LOOPBACK}:{listening.getsockname()[1]}"
        server: uvicorn.Server

        def finished() -> None:
            server.should_exit = True

        config = uvicorn.Config(
            application(run, token, host, finished),
            log_level="critical",
            access_log=False,
            timeout_graceful_shutdown=1,
            server_header=False,
        )
        server = uvicorn.Server(config)
        show(f"http://{host}/{token}/")
        with contextlib.suppress(KeyboardInterrupt):
            server.run(sockets=[listening])
    if run.failure is not None:
        raise run.failure
    return run.ended
