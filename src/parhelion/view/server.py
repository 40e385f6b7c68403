"""The page at an address of this machine: a session behind HTTP and a WebSocket.

Who may come: whoever has the address, which holds a random token. Requests that name another host,
as of a site that was bound to this machine's address (DNS rebinding), and those that come from
another site's page are refused all the same.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import ipaddress
import logging
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import arguments
from ..errors import ResourceError
from .messages import LARGEST, Client, Packer, joined

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.datastructures import Headers
    from starlette.websockets import WebSocket

    from .session import Session

log = logging.getLogger("parhelion")

PAGE = Path(__file__).parent / "page"
FILES = {
    "": ("index.html", "text/html"),
    "view.js": ("view.js", "text/javascript"),
    "view.css": ("view.css", "text/css"),
    "icon.svg": ("icon.svg", "image/svg+xml"),
}
MOST_CLIENTS = 32
# Seconds between asking a client whether it is still there, and until it must have answered.
PING_SECONDS = 20.0

_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self';"
        " img-src 'self' blob: data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Server:
    """Serves a session at `url` from its own thread until it is closed.

    host: the address to listen at; others than those of this machine itself let everyone come who
    has the token. port: 0 for any that is free. Raises ResourceError for one that cannot be had.
    """

    def __init__(self, session: Session, *, host: str = "127.0.0.1", port: int = 0) -> None:
        host, port = arguments.text("host", host), arguments.whole("port", port, 0, 65535)
        self.token = secrets.token_urlsafe(18)
        self.session = session
        self._socket = _listening(host, port)
        self.port = int(self._socket.getsockname()[1])
        self._hosts = _hosts(host)
        shown = "127.0.0.1" if host in ("0.0.0.0", "") else "::1" if host == "::" else host
        shown = f"[{shown}]" if ":" in shown else shown
        self.url = f"http://{shown}:{self.port}/{self.token}/"
        self._packer = Packer(session)
        self._clients = 0
        session.rest(True)  # until somebody looks
        # few, as each keeps memory of its own for pictures; and files, which may have to be waited
        # for, must not hold up the rest
        self._pool = ThreadPoolExecutor(4, "parhelion-view")
        self._savers = ThreadPoolExecutor(2, "parhelion-save")
        self._server: Any = None
        self._ready = threading.Event()
        # told by an event: a thread whose join() was interrupted counts as ended (Python 3.11)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="parhelion-server", daemon=True)
        self._thread.start()
        self._ready.wait(30)
        if self._server is None or not self._server.started:
            self.close()
            raise ResourceError(f"{host} port {self.port}: the server did not start")

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def clients(self) -> int:
        """How many are connected."""
        return self._clients

    def wait(self) -> None:
        """Until it is closed, or KeyboardInterrupt."""
        while not self._ended.wait(3600):
            pass

    def close(self) -> None:
        """Ends all connections."""
        if self._server is not None:
            self._server.should_exit = True
        self._ended.wait(10)
        for pool in (self._pool, self._savers):
            pool.shutdown(wait=False, cancel_futures=True)
        self._socket.close()

    # --- Its thread ------------------------------------------------------------------------------

    def _run(self) -> None:
        import uvicorn

        config = uvicorn.Config(
            self._app(),
            log_level="critical",
            access_log=False,  # its lines would hold the token
            lifespan="off",
            ws="websockets-sansio",
            ws_max_size=LARGEST,
            ws_ping_interval=PING_SECONDS,
            ws_ping_timeout=PING_SECONDS,
            ws_per_message_deflate=False,  # pictures are packed already
            timeout_graceful_shutdown=1,
            server_header=False,
        )
        self._server = uvicorn.Server(config)
        try:
            asyncio.run(self._serve())
        except Exception:
            log.exception("view: the server")
        finally:
            self._ready.set()
            self._ended.set()

    async def _serve(self) -> None:
        task = asyncio.ensure_future(self._server.serve(sockets=[self._socket]))
        while not self._server.started and not task.done():
            await asyncio.sleep(0.005)
        self._ready.set()
        await task

    def _app(self) -> Starlette:
        from starlette.applications import Starlette
        from starlette.requests import Request
        from starlette.responses import FileResponse, PlainTextResponse, Response
        from starlette.routing import Route, WebSocketRoute

        async def page(request: Request) -> Response:
            problem = self._refused(request.headers, request.path_params["token"])
            name = request.path_params.get("name", "")
            if problem or name not in FILES:
                log.warning("view: refused: %s", problem or "no such page")
                return PlainTextResponse("Not found\n", 404, _HEADERS)
            file, kind = FILES[name]
            return FileResponse(PAGE / file, headers=_HEADERS, media_type=kind)

        app = Starlette(
            routes=[
                Route("/{token}/", page),
                WebSocketRoute("/{token}/session", self._talk),
                Route("/{token}/{name}", page),
            ]
        )
        app.router.redirect_slashes = False  # it would answer whoever asks
        return app

    def _refused(self, headers: Headers, token: str) -> str | None:
        """Why a request is not answered; None if it is."""
        host = headers.get("host", "")
        name = _name_of(host)
        if not (name in self._hosts or ("*" in self._hosts and _is_address(name))):
            return f"a request to the host {host[:80]!r}"
        origin = headers.get("origin")
        if origin is not None and origin.partition("://")[2] != host:
            return f"a request from {origin[:80]!r}"
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return "a request without the token"
        return None

    async def _talk(self, ws: WebSocket) -> None:
        """One client, until either side ends it."""
        from starlette.websockets import WebSocketDisconnect

        problem = self._refused(ws.headers, ws.path_params["token"])
        if problem is None and self._clients >= MOST_CLIENTS:
            problem = f"more than {MOST_CLIENTS} clients"
        if problem is not None:
            log.warning("view: refused: %s", problem)
            await ws.close(1008)
            return
        await ws.accept()
        self._clients += 1
        self.session.rest(False)
        loop, due = asyncio.get_running_loop(), asyncio.Event()

        def wake() -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(due.set)

        client = Client(self.session, self._packer, wake)
        due.set()

        async def work(job: Callable[..., Any], *arguments: Any) -> Any:
            return await loop.run_in_executor(self._pool, job, *arguments)

        async def send() -> None:
            while True:
                await due.wait()
                due.clear()
                while (message := await work(client.take)) is not None:
                    await ws.send_bytes(joined(*message))

        try:
            async with _Tasks() as tasks:
                tasks.start(send())
                while not client.over:
                    received = await ws.receive()
                    if received["type"] != "websocket.receive":
                        break
                    raw = received.get("text") or received.get("bytes") or b""
                    later = await work(client.receive, raw)
                    if later is not None:
                        tasks.start(loop.run_in_executor(self._savers, later))
                else:
                    await ws.close(1008)
        except (WebSocketDisconnect, RuntimeError, OSError) as error:
            log.debug("view: a client went away: %s", error)
        finally:
            client.close()
            self._clients -= 1
            if self._clients == 0:
                self.session.rest(True)


class _Tasks:
    """Tasks that end with the block."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Future[Any]] = set()

    async def __aenter__(self) -> _Tasks:
        return self

    def start(self, work: Awaitable[Any]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Future[Any]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and task.exception() is not None:
            log.debug("view: %r", task.exception())

    async def __aexit__(self, *_: object) -> None:
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _listening(host: str, port: int) -> socket.socket:
    try:
        info = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        made = socket.socket(info[0], info[1])
        try:
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            made.bind(info[4])
            made.listen(64)
        except BaseException:
            made.close()
            raise
    except (OSError, OverflowError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ResourceError(f"{host} port {port}: cannot listen there: {reason}") from error
    return made


def _hosts(host: str) -> set[str]:
    """What a browser may call this machine; "*" stands for any address in numbers."""
    local = {"127.0.0.1", "localhost", "::1"}
    if host in ("127.0.0.1", "localhost", "::1"):
        return local
    name = socket.gethostname().lower()
    return local | {host.lower(), name, f"{name}.local", socket.getfqdn().lower(), "*"}


def _name_of(host: str) -> str:
    """The name in a Host header, without the port."""
    if host.startswith("["):
        return host[1:].partition("]")[0].lower()
    return host.partition(":")[0].lower()


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
